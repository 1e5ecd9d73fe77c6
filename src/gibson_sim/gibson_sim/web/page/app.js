// The page: connects one WebSocket with the parts of the page.
import { $, keyed, note, remember, remembered } from './dom.js';
import { Driving } from './drive.js';
import { FloorMap } from './map.js';
import { Panels } from './panels.js';
import { Plots } from './plots.js';
import { Scene3D } from './scene3d.js';
import { Videos } from './videos.js';

let socket = null, robots = [], selectedRobot = remembered('robot', '');

function send(type, values = {}) {
  if (!socket || socket.readyState !== WebSocket.OPEN) return false;
  socket.send(JSON.stringify({ type, ...values }));
  return true;
}

const robot = () => robots.find((r) => r.namespace === selectedRobot) || robots[0];
const toRobot = (values) => ({ ...values, robot: robot()?.namespace || '' });

const videos = new Videos(watch);
const plots = new Plots(send);
const floor = new FloorMap($('map'), { place: placed, select: (name) => panels.select(name) });
const panels = new Panels(send, selected);
const scene = new Scene3D($('scene3d'), explainScene);
const driving = new Driving((type, values) => send(type, toRobot(values)), $('stick'), (moving) => {
  $('driver').textContent = moving ? 'driving' : 'not driving';
  $('driver').className = moving ? 'badge driving' : 'badge quiet';
});

function watch() {
  const topics = [...videos.needed];
  if (!$('scene3d').hidden) topics.push('@scene');
  send('watch', { topics: document.hidden ? [] : topics.slice(-16) });
}

function explainScene() {
  const shown = !$('scene3d').hidden, text = !scene.model ? 'Loading the scene …' : scene.poses ? '' : 'Time is paused, and no poses have arrived yet: press Step.';
  $('scene-note').textContent = text;
  $('scene-note').hidden = !shown || !text;
}

async function showBinary(buffer) {
  if (new Uint8Array(buffer, 0, 1)[0] === 2) { scene.setPoses(buffer); explainScene(); send('shown', { topic: '@scene' }); return; }
  const view = new DataView(buffer), length = view.getUint16(2, true), stamp = view.getFloat64(4, true);
  const topic = new TextDecoder().decode(new Uint8Array(buffer, 12, length));
  try { await videos.show(topic, stamp, buffer.slice(12 + length)); } finally { send('shown', { topic }); }
}

// Received messages

const on = {
  topics(value) { videos.setTopics(value); },
  problems(value) { videos.setProblems(value); },
  plottable(value) { plots.setTopics(value); },
  samples(value) { plots.addSamples(value); },
  history(value) { plots.setHistory(value); },
  status(value) {
    $('state').textContent = value.state; $('state').className = `badge ${value.state.replaceAll(' ', '-')}`;
    $('time').textContent = value.time === null ? '–' : value.time.toFixed(2);
    $('factor').textContent = value.factor === null ? '–' : value.factor.toFixed(2);
    for (const id of ['play', 'pause', 'step', 'reset', 'rate']) $(id).disabled = value.state === 'connected'; // no simulation: time cannot be controlled
    videos.setState(value.state);
    panels.setDiagnostics(value.diagnostics);
  },
  rate(value) { showRate(value); },
  floors(value) { floor.setFloors(value).then(showFloors); },
  robots(value) {
    robots = value;
    const r = robot();
    $('pose').textContent = r ? `x ${r.x.toFixed(2)}  y ${r.y.toFixed(2)} m  ${(r.yaw * 180 / Math.PI).toFixed(0)}°  ${r.speed.toFixed(2)} m/s` : '';
    $('robot').hidden = value.length < 2;
    keyed($('robot'), value, (v) => v.namespace, () => new Option(), (option, v) => { option.value = v.namespace; option.textContent = v.name; });
    if (r) $('robot').value = r.namespace;
    floor.robots = value; floor.chosen = r?.namespace; floor.draw();
    panels.setRobot(r);
    followRobot();
    if (!$('scene3d').hidden) scene.setRobot(r);
  },
  scene(value) { scene.load(value.version); },
  scan(value) { floor.scan = value; floor.draw(); },
  paths(value) { floor.paths = value; floor.draw(); },
  estimates(value) { floor.estimates = value; floor.draw(); },
  places(value) { floor.places = value; floor.draw(); },
  doors(value) { panels.setDoors(value); floor.doors = value; floor.draw(); },
  entities(value) { panels.setEntities(value); floor.entities = value; floor.draw(); },
  catalogue(value) {
    const previous = $('catalogue').value;
    const groups = [['objects', value.filter((c) => !c.robot)], ['robots', value.filter((c) => c.robot)]].filter(([, items]) => items.length);
    $('catalogue').replaceChildren(...groups.map(([label, items]) => {
      const group = Object.assign(document.createElement('optgroup'), { label });
      group.append(...items.map((c) => new Option(c.name, c.uri, false, c.uri === previous)));
      return group;
    }));
    $('catalogue').hidden = !value.length;
    nameSpawn();
  },
  recording(value) { panels.setRecording(value); },
  task(value) { panels.setTask(value); floor.target = value.goal; floor.draw(); },
  reply(value) {
    if (value.to === 'Fields' && value.ok) plots.setFields(value.value);
    else if (!value.ok) note(value.text, true);
    else if (value.text) note(value.text);
  },
};

// Selects an object, and shows its floor.
function selected(name) {
  const entity = floor.entities.find((e) => e.name === name);
  floor.selected = name;
  if (entity && entity.floor !== floor.shown && entity.floor < floor.floors.length) showFloor(entity.floor); else floor.draw();
}

// Shows a floor; that of the robot is followed from then on.
function showFloor(number) {
  const r = robot();
  floor.followed = !r || r.floor === number;
  floor.show(number);
  showFloors();
}

// Goes with the robot to another floor, unless another floor than the robot's was chosen.
function followRobot() {
  const r = robot();
  if (r && floor.followed && r.floor !== floor.shown && r.floor < floor.floors.length) floor.show(r.floor);
  showFloors();
}

function showFloors() {
  const r = robot(), select = $('floor');
  select.hidden = floor.floors.length < 2 || !$('scene3d').hidden;
  if (document.activeElement === select) return;
  const rows = floor.floors.map((f, number) => ({ number, text: `Floor ${number}${r && r.floor === number ? ' (robot)' : ''}`, z: f.z }));
  rows.sort((a, b) => (r ? (b.number === r.floor) - (a.number === r.floor) : 0) || a.number - b.number);
  keyed(select, rows, (row) => String(row.number), () => new Option(), (option, row) => { option.value = row.number; option.title = `${row.z.toFixed(2)} m`; if (option.textContent !== row.text) option.textContent = row.text; });
  select.value = floor.shown;
}

// The button names the selected object: on a phone the list may be out of sight.
function nameSpawn() {
  const chosen = $('catalogue').selectedOptions[0]?.text;
  document.querySelector('[data-mode=spawn]').textContent = chosen ? `Spawn ${chosen}` : 'Spawn';
}

// Shows the rate of the simulation, including changes by other clients.
function showRate(rate) {
  const select = $('rate');
  if (rate === null || document.activeElement === select) return;
  const text = String(rate);
  if (![...select.options].some((o) => o.value === text)) select.append(new Option(`${Number(rate.toPrecision(3))}×`, text));
  select.value = text;
}

// Shows the symbols of the items on the map.
function showLegend() {
  for (const li of document.querySelectorAll('#legend li')) {
    const shown = floor.here(floor[li.dataset.of]);
    li.hidden = !(li.dataset.of === 'entities' ? shown.some((e) => !e.robot) : shown.length);
  }
}
setInterval(showLegend, 500);

function placed(pose) {
  const mode = floor.mode;
  if ((mode === 'spawn' || (mode === 'move' && panels.selected)) && !floor.hasFloor(pose.x, pose.y)) note('The map shows no floor there: an object without floor below it falls.', true);
  if (mode === 'goal' || mode === 'initial_pose') send(mode, toRobot(pose));
  if (mode === 'spawn' && $('catalogue').value) send('spawn', { uri: $('catalogue').value, ...pose });
  if (mode === 'move') panels.selected ? send('move', { name: panels.selected, ...pose }) : note('Select an object in the list or on the map first.', true);
}

for (const button of document.querySelectorAll('.mode')) button.onclick = () => {
  floor.mode = button.dataset.mode;
  document.querySelectorAll('.mode').forEach((b) => b.setAttribute('aria-pressed', b === button));
  $('map').classList.toggle('place', floor.mode !== 'look');
};
$('fit').onclick = () => floor.fit();
$('floor').onchange = () => { $('floor').blur(); showFloor(Number($('floor').value)); };
$('three').onclick = () => {
  const shown = $('scene3d').hidden;
  if (shown && !scene.gl) return note('The 3-D view needs WebGL 2, which this browser does not have.', true);
  $('scene3d').hidden = !shown; $('map').hidden = shown; $('legend').hidden = shown; $('follow').hidden = !shown; $('fit').hidden = shown;
  $('three').setAttribute('aria-pressed', shown);
  document.querySelectorAll('.mode').forEach((b) => { b.hidden = shown; });
  watch(); explainScene(); showFloors();
};
$('follow').onclick = () => { scene.follow = !scene.follow; $('follow').setAttribute('aria-pressed', scene.follow); };
function togglePlots(shown) {
  $('plot-card').hidden = !shown;
  $('plots-toggle').setAttribute('aria-pressed', shown);
  remember('plots-shown', shown);
  plots.subscribe();
}
$('plots-toggle').onclick = () => togglePlots($('plot-card').hidden);
$('robot').onchange = () => { driving.release(); selectedRobot = $('robot').value; remember('robot', selectedRobot); floor.followed = true; followRobot(); $('robot').blur(); };
$('play').onclick = () => send('time', { action: 'play' });
$('pause').onclick = () => send('time', { action: 'pause' });
$('step').onclick = () => send('time', { action: 'step', steps: 10 });
$('reset').onclick = () => send('time', { action: 'reset' });
$('rate').onchange = () => { send('rate', { value: Number($('rate').value) }); $('rate').blur(); };
$('catalogue').onchange = nameSpawn;
$('speed').oninput = () => { $('speed-value').textContent = Number($('speed').value).toFixed(1); driving.speed = Number($('speed').value); };
document.addEventListener('visibilitychange', () => { driving.release(); watch(); plots.subscribe(); });
setInterval(() => { $('images').textContent = videos.images; videos.images = 0; }, 1000);

// The connection; reconnects after a loss.

function connect() {
  socket = new WebSocket(`${location.protocol === 'https:' ? 'wss' : 'ws'}://${location.host}/socket`);
  socket.binaryType = 'arraybuffer';
  socket.onopen = () => { $('state').textContent = 'connected'; $('state').className = 'badge'; watch(); plots.subscribe(); };
  socket.onmessage = (event) => {
    if (typeof event.data !== 'string') return void showBinary(event.data);
    const message = JSON.parse(event.data);
    on[message.type]?.(message.value);
  };
  socket.onclose = () => {
    driving.release();
    $('state').textContent = 'connection lost'; $('state').className = 'badge lost';
    setTimeout(connect, 1000);
  };
}
history.replaceState(null, '', location.pathname); // hide the token, which is now in a cookie
togglePlots(remembered('plots-shown', false));
connect();
