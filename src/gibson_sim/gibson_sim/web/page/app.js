// The page: one WebSocket; the parts of the page tell it what to ask for, and it tells them what came.
import { FloorMap } from './map.js';
import { Driving } from './drive.js';
import { Scene3D } from './scene3d.js';

const $ = (id) => document.getElementById(id);
const known = { topics: [], entities: [], catalogue: [] };
const watched = new Set(JSON.parse(localStorage.getItem('watched') || '[]'));
const videos = new Map();
let socket = null, selected = '', images = 0, lastStamp = 0;

export function send(type, values = {}) {
  if (!socket || socket.readyState !== WebSocket.OPEN) return false;
  socket.send(JSON.stringify({ type, ...values }));
  return true;
}

function note(text, bad = false) {
  const p = document.createElement('p');
  p.textContent = text;
  p.className = bad ? 'bad' : '';
  $('notes').append(p);
  setTimeout(() => p.remove(), 5000);
}

// Videos

function watch() {
  localStorage.setItem('watched', JSON.stringify([...watched]));
  const topics = [...watched].filter((t) => videos.has(t));
  if (!$('scene3d').hidden) topics.push('@scene');
  send('watch', { topics: document.hidden ? [] : topics });
}

function showVideos() {
  const there = new Set(known.topics.map((t) => t.topic));
  if (![...watched].some((t) => there.has(t)) && known.topics.length) watched.add(known.topics[0].topic);
  $('topics').replaceChildren(...known.topics.map((t) => {
    const button = document.createElement('button');
    button.textContent = t.label;
    button.title = t.topic;
    button.setAttribute('aria-pressed', watched.has(t.topic));
    button.onclick = () => { watched.has(t.topic) ? watched.delete(t.topic) : watched.add(t.topic); showVideos(); };
    return button;
  }));
  for (const [topic, video] of videos) if (!watched.has(topic) || !there.has(topic)) { video.figure.remove(); videos.delete(topic); }
  for (const t of known.topics) {
    if (!watched.has(t.topic) || videos.has(t.topic)) continue;
    const figure = document.createElement('figure'), canvas = document.createElement('canvas'), caption = document.createElement('figcaption');
    const picture = document.createElement('button');
    picture.textContent = 'save'; picture.title = 'save this image as a PNG file';
    picture.onclick = () => canvas.toBlob((blob) => {
      const a = document.createElement('a');
      a.href = URL.createObjectURL(blob); a.download = `${t.label.replace(/\W+/g, '_')}.png`; a.click();
      URL.revokeObjectURL(a.href);
    });
    caption.append(t.label, picture);
    canvas.dataset.topic = t.topic;
    figure.append(canvas, caption);
    videos.set(t.topic, { figure, canvas, context: canvas.getContext('2d') });
    $('videos').append(figure);
  }
  $('videos').style.gridTemplateColumns = videos.size > 2 ? '1fr 1fr' : '1fr';
  if (!videos.size && !$('videos').children.length) {
    const p = document.createElement('p');
    p.className = 'empty'; p.textContent = known.topics.length ? 'Choose a camera above.' : 'No camera publishes images.';
    $('videos').append(p);
  } else if (videos.size) $('videos').querySelectorAll('.empty').forEach((e) => e.remove());
  watch();
}

async function showImage(buffer) {
  if (new Uint8Array(buffer, 0, 1)[0] === 2) { scene.setPoses(buffer); send('shown', { topic: '@scene' }); return; }
  const view = new DataView(buffer), length = view.getUint16(2, true), stamp = view.getFloat64(4, true);
  const topic = new TextDecoder().decode(new Uint8Array(buffer, 12, length));
  try {
    const bitmap = await createImageBitmap(new Blob([new Uint8Array(buffer, 12 + length)], { type: 'image/jpeg' }));
    const video = videos.get(topic);
    if (video) {
      if (video.canvas.width !== bitmap.width || video.canvas.height !== bitmap.height) { video.canvas.width = bitmap.width; video.canvas.height = bitmap.height; }
      video.context.drawImage(bitmap, 0, 0);
      video.canvas.dataset.stamp = lastStamp = stamp;
      images++;
    }
    bitmap.close();
  } finally { send('shown', { topic }); }
}

// What came

const floor = new FloorMap($('map'), (pose) => placed(pose));
const scene = new Scene3D($('scene3d'));
const driving = new Driving(send, $('stick'), (moving) => {
  $('driver').textContent = moving ? 'you drive' : 'nobody drives';
  $('driver').className = moving ? 'badge driving' : 'badge quiet';
});

const on = {
  topics(value) { known.topics = value; showVideos(); },
  status(value) {
    $('state').textContent = value.state; $('state').className = `badge ${value.state}`;
    if (value.time !== null) $('time').textContent = value.time.toFixed(2);
    $('factor').textContent = value.factor === null ? '–' : value.factor.toFixed(2);
    $('diagnostics').replaceChildren(...value.diagnostics.map((d) => {
      const li = document.createElement('li'), span = document.createElement('span'), small = document.createElement('small');
      li.className = `level${d.level}`; small.textContent = d.message; span.append(d.name, ' ', small); li.append(span);
      li.title = d.values.map(([k, v]) => `${k}: ${v}`).join('\n');
      return li;
    }));
  },
  map(value) { floor.setMap(value); },
  robots(value) {
    const r = value[0];
    $('pose').textContent = r ? `x ${r.x.toFixed(2)}  y ${r.y.toFixed(2)} m  ${(r.yaw * 180 / Math.PI).toFixed(0)}°  ${r.speed.toFixed(2)} m/s` : '';
    floor.robots = value; floor.draw(); if (!$('scene3d').hidden) scene.setRobots(value);
  },
  scene(value) { scene.load(value.version); },
  scan(value) { floor.scan = value; floor.draw(); },
  path(value) { floor.path = value; floor.draw(); },
  estimate(value) { floor.estimate = value; floor.draw(); },
  places(value) { floor.places = value; floor.draw(); },
  entities(value) { known.entities = value; showThings(); },
  catalogue(value) {
    known.catalogue = value;
    const chosen = $('catalogue').value;
    $('catalogue').replaceChildren(...value.map((c) => new Option(c.name, c.uri, false, c.uri === chosen)));
  },
  reply(value) { if (!value.ok) note(value.text, true); else if (value.text) note(value.text); },
};

function showThings() {
  floor.entities = known.entities; floor.selected = selected; floor.draw();
  $('things').replaceChildren(...known.entities.map((e) => {
    const li = document.createElement('li'), span = document.createElement('span'), remove = document.createElement('button');
    span.textContent = e.name; remove.textContent = '×'; remove.title = `delete ${e.name}`;
    li.setAttribute('aria-selected', e.name === selected);
    li.onclick = () => { selected = e.name; showThings(); };
    remove.onclick = (event) => { event.stopPropagation(); send('delete', { name: e.name }); };
    li.append(span); if (!e.robot) li.append(remove);
    return li;
  }));
}

function placed(pose) {
  const mode = floor.mode;
  if (mode === 'goal' || mode === 'initial_pose') send(mode, pose);
  if (mode === 'spawn' && $('catalogue').value) send('spawn', { uri: $('catalogue').value, ...pose });
  if (mode === 'move') selected ? send('move', { name: selected, ...pose }) : note('Select a thing in the list first.', true);
}

for (const button of document.querySelectorAll('.mode')) button.onclick = () => {
  floor.mode = button.dataset.mode;
  document.querySelectorAll('.mode').forEach((b) => b.setAttribute('aria-pressed', b === button));
  $('map').classList.toggle('place', floor.mode !== 'look');
};
$('fit').onclick = () => floor.fit();
$('three').onclick = () => {
  const shown = $('scene3d').hidden;
  if (shown && !scene.gl) return note('This browser has no WebGL 2.', true);
  $('scene3d').hidden = !shown; $('map').hidden = shown; $('follow').hidden = !shown; $('fit').hidden = shown;
  $('three').setAttribute('aria-pressed', shown);
  document.querySelectorAll('.mode').forEach((b) => { b.disabled = shown; b.title = shown ? 'on the map: leave 3-D first' : ''; });
  watch();
};
$('follow').onclick = () => { scene.follow = !scene.follow; $('follow').setAttribute('aria-pressed', scene.follow); };
$('play').onclick = () => send('time', { action: 'play' });
$('pause').onclick = () => send('time', { action: 'pause' });
$('step').onclick = () => send('time', { action: 'step', steps: 10 });
$('reset').onclick = () => send('time', { action: 'reset' });
$('rate').onchange = () => send('rate', { value: Number($('rate').value) });
$('speed').oninput = () => { $('speed-value').textContent = $('speed').value; driving.speed = Number($('speed').value); };
document.addEventListener('visibilitychange', () => { driving.release(); watch(); });
setInterval(() => { $('images').textContent = images; images = 0; }, 1000);

// The connection; lost ones are made again.

function connect() {
  socket = new WebSocket(`${location.protocol === 'https:' ? 'wss' : 'ws'}://${location.host}/socket`);
  socket.binaryType = 'arraybuffer';
  socket.onopen = () => { $('state').textContent = 'connected'; $('state').className = 'badge'; watch(); };
  socket.onmessage = (event) => {
    if (typeof event.data !== 'string') return void showImage(event.data);
    const message = JSON.parse(event.data);
    on[message.type]?.(message.value);
  };
  socket.onclose = () => {
    driving.release();
    $('state').textContent = 'connection lost'; $('state').className = 'badge lost';
    setTimeout(connect, 1000);
  };
}
history.replaceState(null, '', location.pathname); // the token is in a cookie by now
connect();
