// The page: connects one WebSocket with the panels.
import { $, keyed, note, remember, remembered } from './dom.js';
import { Driving } from './drive.js';
import { Inspector } from './inspector.js';
import { Layout } from './layout.js';
import { Log } from './log.js';
import { FloorMap } from './map.js';
import { Plots } from './plots.js';
import { Recordings } from './recordings.js';
import { Scene3D } from './scene3d.js';
import { Task } from './task.js';
import { Tree } from './tree.js';
import { Videos } from './videos.js';

const FIRST_MS = 4000; // time that the 3-D scene waits for the first image
const LOW = 0.5; // share of the speed of time that the page offers to a busy machine

const address = `${location.protocol === 'https:' ? 'wss' : 'ws'}://${location.host}/socket`;
let socket = new WebSocket(address); // at once: it connects while the panels are made
let robots = [], selectedRobot = remembered('robot', ''), selected = '', entities = [], rate = 1, connectedAt = Infinity, layout = null;

function send(type, values = {}) {
  if (!socket || socket.readyState !== WebSocket.OPEN) return false;
  socket.send(JSON.stringify({ type, ...values }));
  return true;
}

const robot = () => robots.find((r) => r.namespace === selectedRobot) || robots[0];
const toRobot = (values) => ({ ...values, robot: robot()?.namespace || '' });
const visible = (panel) => Boolean(layout?.visible(panel));

const videos = new Videos(watch);
const plots = new Plots(send, () => visible('plots'));
const scene = new Scene3D($('scene3d'), { ready: explainScene, place: placed, select, move: moveTo, drawn: () => send('shown', { topic: '@scene' }) });
const floor = new FloorMap($('map'), { place: placed, select, move: moveTo, drawn: showLegend });
const tree = new Tree(send, select);
const inspector = new Inspector(send, { look: lookAt, drive: driveRobot });
const task = new Task(send);
const recordings = new Recordings(send);
const log = new Log(showBusy);
const driving = new Driving((type, values) => send(type, toRobot(values)), $('stick'), (moving) => {
  $('driver').textContent = moving ? 'driving' : 'not driving';
  $('driver').className = moving ? 'badge driving' : 'badge quiet';
});
layout = new Layout($('dock'), arranged);

// Sends the topics that the page shows. The 3-D scene waits for the first image, which would otherwise wait for its textures.
function watch() {
  const topics = [...videos.needed], with3d = visible('view3d') && (videos.seen || performance.now() > connectedAt + FIRST_MS);
  scene.enable(with3d);
  if (with3d && scene.gl) topics.push('@scene');
  send('watch', { topics: document.hidden ? [] : topics.slice(-16) });
}

// After every change of what is visible.
function arranged() {
  if (!layout) return; // while it is made
  videos.visible = visible('images');
  ($('panel-map').hidden && !$('panel-view3d').hidden ? $('panel-view3d') : $('panel-map')).querySelector('nav').prepend($('tools'));
  watch(); plots.subscribe(); explainScene();
  if (visible('recordings')) recordings.refresh();
}

function explainScene() {
  const text = scene.gl === null ? 'The 3-D view needs WebGL 2, which this browser does not have.' : !scene.model ? 'Loading the scene …' : scene.poses ? '' : 'Time is paused, and no poses have arrived yet: press Step.';
  $('scene-note').textContent = text;
  $('scene-note').hidden = !text;
}

async function showBinary(buffer) {
  if (new Uint8Array(buffer, 0, 1)[0] === 2) { scene.setPoses(buffer); explainScene(); return; }
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
    $('play').setAttribute('aria-pressed', value.state === 'playing'); $('pause').setAttribute('aria-pressed', value.state === 'paused');
    videos.setState(value.state);
    log.set(value.diagnostics, value.time);
  },
  rate(value) { showRate(value); },
  floors(value) { floor.setFloors(value).then(showFloors); tree.setFloors(value.length); inspector.floors = value.length; },
  robots(value) {
    robots = value;
    const r = robot();
    $('pose').textContent = r ? `x ${r.x.toFixed(2)}  y ${r.y.toFixed(2)} m  ${(r.yaw * 180 / Math.PI).toFixed(0)}°  ${r.speed.toFixed(2)} m/s` : '';
    $('robot').hidden = value.length < 2;
    keyed($('robot'), value, (v) => v.namespace, () => new Option(), (option, v) => { option.value = v.namespace; option.textContent = v.name; });
    if (r) $('robot').value = r.namespace;
    floor.robots = value; floor.chosen = r?.namespace; floor.draw();
    tree.setRobot(r); inspector.setRobots(value);
    followRobot();
    scene.setRobot(r);
  },
  joints(value) { inspector.setJoints(value); },
  scene(value) { scene.offer(value.version); },
  scan(value) { floor.scan = value; floor.draw(); },
  paths(value) { floor.paths = value; floor.draw(); },
  estimates(value) { floor.estimates = value; floor.draw(); },
  places(value) { floor.places = value; floor.draw(); },
  rooms(value) { floor.rooms = value; floor.draw(); tree.setRooms(value); inspector.setRooms(value); },
  doors(value) { tree.setDoors(value); inspector.setDoors(value); floor.doors = value; floor.draw(); },
  entities(value) {
    entities = value;
    tree.setEntities(value); inspector.setEntities(value); floor.entities = value; floor.draw();
    if (selected && !value.some((e) => e.name === selected)) select('');
  },
  catalogue(value) {
    const previous = $('catalogue').value;
    const groups = [['objects', value.filter((c) => !c.robot)], ['robots', value.filter((c) => c.robot)]].filter(([, items]) => items.length);
    $('catalogue').replaceChildren(...groups.map(([label, items]) => {
      const group = Object.assign(document.createElement('optgroup'), { label });
      group.append(...items.map((c) => new Option(c.name, c.uri, false, c.uri === previous)));
      return group;
    }));
    showTool();
  },
  recording(value) { recordings.set(value); },
  task(value) { task.set(value); floor.target = value.goal; floor.draw(); },
  reply(value) {
    if (value.to === 'Fields' && value.ok) plots.setFields(value.value);
    else if (!value.ok) note(value.text, true);
    else if (value.text) note(value.text);
  },
};

// Selection

// Selects a robot, a door or a thing in all panels, and shows its floor; '' = none.
function select(name) {
  const entity = entities.find((e) => e.name === name) ?? null;
  selected = entity ? name : '';
  floor.selected = scene.selected = selected;
  tree.select(selected);
  inspector.select(entity);
  if (entity && !layout.isNarrow) layout.show('inspector');
  if (entity && entity.floor !== floor.shown && entity.floor < floor.floors.length) showFloor(entity.floor);
  floor.draw(); scene.draw();
}

function lookAt(entity) {
  if (!visible('map') && !visible('view3d')) layout.show('map');
  floor.lookAt(entity.x, entity.y);
  setFollow(false);
  scene.lookAt(entity);
}

function driveRobot(namespace) {
  driving.release(); selectedRobot = namespace; remember('robot', namespace); floor.followed = true; followRobot();
  layout.show('drive');
}

// Moves a thing that was dragged, at its height and heading.
function moveTo(entity, x, y) {
  warnOfNoFloor(x, y);
  send('move', { name: entity.name, x, y, z: entity.z, yaw: entity.yaw });
}

// Floors

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
  const r = robot(), choice = $('floor');
  scene.setFloor(floor.floors[floor.shown]?.z ?? 0);
  choice.hidden = floor.floors.length < 2;
  if (document.activeElement === choice) return;
  const rows = floor.floors.map((f, number) => ({ number, text: `Floor ${number}${r && r.floor === number ? ' (robot)' : ''}`, z: f.z }));
  rows.sort((a, b) => (r ? (b.number === r.floor) - (a.number === r.floor) : 0) || a.number - b.number);
  keyed(choice, rows, (row) => String(row.number), () => new Option(), (option, row) => { option.value = row.number; option.title = `${row.z.toFixed(2)} m`; if (option.textContent !== row.text) option.textContent = row.text; });
  choice.value = floor.shown;
}

// Tools of map and 3-D

function showTool() {
  for (const button of document.querySelectorAll('.mode')) button.setAttribute('aria-pressed', button.dataset.mode === floor.mode);
  for (const canvas of [$('map'), $('scene3d')]) canvas.classList.toggle('place', floor.mode !== 'look');
  const chosen = $('catalogue').selectedOptions[0]?.text;
  document.querySelector('[data-mode=spawn]').title = chosen ? `spawn ${chosen} where you click` : 'spawn the catalogue object where you click';
}

function placed(pose) {
  const mode = floor.mode;
  if (mode === 'spawn' || (mode === 'move' && selected)) warnOfNoFloor(pose.x, pose.y);
  if (mode === 'goal' || mode === 'initial_pose') send(mode, toRobot(pose));
  if (mode === 'spawn' && $('catalogue').value) send('spawn', { uri: $('catalogue').value, ...pose });
  if (mode === 'move') selected ? send('move', { name: selected, ...pose }) : note('Select a thing first: in the list, on the map or in 3-D.', true);
}

function warnOfNoFloor(x, y) { if (!floor.hasFloor(x, y)) note('The map shows no floor there: an object without floor below it falls.', true); }

// Shows the symbols of what the map shows; drawn: kind -> its name.
function showLegend(drawn) {
  const key = [...drawn.keys()].sort().join() + matchMedia('(prefers-color-scheme: dark)').matches;
  if ($('legend').dataset.key === key) return;
  $('legend').dataset.key = key;
  $('legend').replaceChildren(...[...drawn].sort(([a], [b]) => a.localeCompare(b)).map(([kind, name]) => {
    const li = document.createElement('li'), canvas = document.createElement('canvas');
    li.dataset.of = kind;
    floor.symbol(kind, canvas);
    li.append(canvas, name);
    return li;
  }));
}

// Shows the rate of the simulation, including changes by other clients.
function showRate(value) {
  const choice = $('rate');
  if (value === null) return;
  rate = value;
  $('busy-slow').hidden = !rate;
  $('busy-slow').textContent = `Slow time to ${Number((LOW * rate).toPrecision(3))}×`;
  if (document.activeElement === choice) return;
  const text = String(value);
  if (![...choice.options].some((o) => o.value === text)) choice.append(new Option(`${Number(value.toPrecision(3))}×`, text));
  choice.value = text;
}

// Says that render nodes skip images, and what can be done while the simulation runs; counts: images per second that were drawn, and that were due.
function showBusy(counts) {
  videos.busy = Boolean(counts);
  $('busy').hidden = !counts;
  if (!counts) return;
  const text = `${Math.round(counts[0])} of ${Math.round(counts[1])} images/s: this machine is busy.`;
  if ($('busy-text').textContent !== text) $('busy-text').textContent = text;
  $('busy').title = 'At the next start, smaller or fewer images help: --camera-rate 10, --view-rate 10, --view-size 320x240.';
  $('busy-one').hidden = videos.live.length < 2;
}

function setFollow(follow) { scene.follow = follow; $('follow').setAttribute('aria-pressed', follow); if (follow) scene.setRobot(robot()); }

for (const button of document.querySelectorAll('.mode')) button.onclick = () => { floor.mode = scene.mode = button.dataset.mode; showTool(); floor.draw(); };
$('fit').onclick = () => floor.fit();
$('floor').onchange = () => { $('floor').blur(); showFloor(Number($('floor').value)); };
$('follow').onclick = () => setFollow(!scene.follow);
$('cut').onclick = () => { scene.cuts = !scene.cuts; $('cut').setAttribute('aria-pressed', scene.cuts); scene.draw(); };
$('robot').onchange = () => { driveRobot($('robot').value); $('robot').blur(); };
$('play').onclick = () => send('time', { action: 'play' });
$('pause').onclick = () => send('time', { action: 'pause' });
$('step').onclick = () => send('time', { action: 'step', steps: 10 });
$('reset').onclick = () => send('time', { action: 'reset' });
$('rate').onchange = () => { send('rate', { value: Number($('rate').value) }); $('rate').blur(); };
$('busy-slow').onclick = () => send('rate', { value: LOW * rate });
$('busy-one').onclick = () => videos.showOne();
$('catalogue').onchange = showTool;
$('speed').oninput = () => { $('speed-value').textContent = Number($('speed').value).toFixed(1); driving.speed = Number($('speed').value); };
document.addEventListener('visibilitychange', () => { driving.release(); watch(); plots.subscribe(); });
setInterval(() => { $('images').textContent = videos.images; videos.images = 0; }, 1000);

// The connection; reconnects after a loss.

function connect(made) {
  socket = made;
  socket.binaryType = 'arraybuffer';
  socket.onopen = () => { connectedAt = performance.now(); setTimeout(watch, FIRST_MS + 50); $('state').textContent = 'connected'; $('state').className = 'badge'; watch(); plots.subscribe(); };
  socket.onmessage = (event) => {
    if (typeof event.data !== 'string') return void showBinary(event.data);
    const message = JSON.parse(event.data);
    on[message.type]?.(message.value);
  };
  socket.onclose = () => {
    driving.release();
    $('state').textContent = 'connection lost'; $('state').className = 'badge lost';
    setTimeout(() => connect(new WebSocket(address)), 1000);
  };
}
history.replaceState(null, '', location.pathname); // hide the token, which is now in a cookie
showTool();
arranged();
connect(socket);
