// The selected robot, door or thing: class, place, pose to read and to change, joints with sliders, deletion.
import { $, element } from './dom.js';
import { roomOf, words } from './tree.js';

const DEGREES = 180 / Math.PI;
const SURE_MS = 3000; // time for which a button asks whether to delete
const SEND_MS = 100; // shortest interval between two commands of a slider
const HOLD_MS = 1500; // time for which a slider keeps the value that it was set to

export class Inspector {
  // send: request to the server; on.look(entity): show it on map and in 3-D; on.drive(namespace): drive this robot.
  constructor(send, on) {
    this.send = send; this.on = on; this.entity = null; this.name = ''; this.doors = []; this.joints = {}; this.robots = []; this.rooms = []; this.floors = 1;
  }

  // Shows another entity; null = none.
  select(entity) {
    this.entity = entity; this.name = entity?.name ?? '';
    $('inspector-empty').hidden = Boolean(entity);
    $('inspector').replaceChildren();
    this.sliders = new Map(); this.inputs = null;
    if (entity) { this.build(); this.update(); }
  }

  setEntities(entities) {
    if (!this.name) return;
    const entity = entities.find((e) => e.name === this.name);
    if (!entity) return this.select(null);
    this.entity = entity;
    this.update();
  }

  setDoors(doors) { this.doors = doors; this.update(); }
  setJoints(joints) { this.joints = joints; this.update(); }
  setRobots(robots) { this.robots = robots; this.update(); }
  setRooms(rooms) { this.rooms = rooms; this.update(); }

  get robot() { return this.entity?.robot ? this.robots.find((r) => r.name === this.name || r.namespace === this.name) : null; }

  build() {
    const e = this.entity, form = element('form', '', { className: 'pose', noValidate: true, id: 'pose-form' });
    this.title = element('h2', e.name); this.about = element('p', '', { className: 'hint' });
    this.inputs = Object.fromEntries([['x', 'm'], ['y', 'm'], ['z', 'm'], ['yaw', '°']].map(([key, unit]) => {
      const label = element('label'), input = element('input', '', { type: 'number', step: key === 'yaw' ? 5 : 0.05, id: `pose-${key}` });
      label.append(element('span', key), input, element('small', unit)); form.append(label);
      return [key, input];
    }));
    const move = element('button', 'Move', { type: 'submit', title: 'move it to this pose' });
    move.setAttribute('form', form.id);
    form.onsubmit = (event) => { event.preventDefault(); this.move(); };
    const row = element('div', '', { className: 'row wrap' }), look = element('button', 'Look at', { title: 'show it on the map and in 3-D' });
    look.onclick = () => this.on.look(this.entity);
    row.append(move, look);
    if (e.robot) { const drive = element('button', 'Drive this robot', { id: 'inspector-drive' }); drive.onclick = () => this.on.drive(this.robot?.namespace ?? ''); row.append(drive); } else row.append(this.deletion());
    this.jointList = element('div', '', { id: 'joints' });
    $('inspector').append(this.title, this.about, form, row, this.jointList);
  }

  deletion() {
    const button = element('button', 'Delete', { id: 'delete', className: 'delete' });
    button.onclick = () => {
      if (button.classList.contains('sure')) { this.send('delete', { name: this.name }); return; }
      button.classList.add('sure'); button.textContent = 'Delete it?';
      setTimeout(() => { button.classList.remove('sure'); button.textContent = 'Delete'; }, SURE_MS);
    };
    return button;
  }

  move() {
    const [x, y, z, yaw] = ['x', 'y', 'z', 'yaw'].map((key) => Number(this.inputs[key].value));
    this.send('move', { name: this.name, x, y, z, yaw: yaw / DEGREES });
    document.activeElement.blur();
  }

  update() {
    const e = this.entity;
    if (!e || !this.inputs) return;
    const room = roomOf(e, this.rooms), place = [e.class && e.class !== 'robot' ? words(e.class) : e.robot ? 'robot' : '', room && words(room), this.floors > 1 ? `floor ${e.floor}` : ''].filter(Boolean);
    this.about.textContent = place.join(' · ');
    const pose = this.robot ?? e, values = { x: pose.x, y: pose.y, z: pose.z ?? e.z, yaw: pose.yaw * DEGREES };
    for (const [key, input] of Object.entries(this.inputs)) if (document.activeElement !== input) input.value = Number(values[key].toFixed(key === 'yaw' ? 1 : 3));
    const rows = [
      ...this.doors.filter((d) => d.joint.startsWith(`${e.name}/`)).map((d) => ({
        key: d.joint, name: words(d.joint.slice(e.name.length + 1)), lower: 0, upper: 100, step: 1, value: 100 * d.opening, text: `${Math.round(100 * d.opening)} % open`, once: true,
        move: (value) => this.send('open', { joint: d.joint, opening: value / 100 }),
      })),
      ...(e.robot ? (this.joints[this.robot?.namespace ?? ''] ?? []) : []).map((j) => ({
        key: j.name, name: words(j.name), lower: j.lower, upper: j.upper, value: j.position, text: `${j.position.toFixed(3)} ${j.unit}`,
        move: (value) => this.send('joint', { robot: this.robot?.namespace ?? '', joint: j.name, position: value }),
      })),
    ];
    for (const [key, slider] of this.sliders) if (!rows.some((row) => row.key === key)) { slider.box.remove(); this.sliders.delete(key); }
    for (const row of rows) {
      if (!this.sliders.has(row.key)) this.sliders.set(row.key, this.slider(row));
      const slider = this.sliders.get(row.key);
      slider.row = row;
      slider.text.textContent = row.text;
      if (performance.now() > slider.until) slider.input.value = row.value;
    }
  }

  // Returns a slider of a joint: a door moves once it is released, a joint of a robot follows.
  slider(row) {
    const box = element('label', '', { className: 'joint' }), text = element('output'), head = element('span');
    const input = element('input', '', { type: 'range', min: row.lower, max: row.upper, step: row.step || 'any', value: row.value });
    input.dataset.joint = row.key;
    head.append(element('b', row.name), text);
    box.append(head, input);
    const slider = { box, text, input, row, until: 0, sent: 0 };
    const send = () => { slider.sent = performance.now(); slider.row.move(Number(input.value)); };
    input.oninput = () => { slider.until = performance.now() + HOLD_MS; if (!row.once && performance.now() - slider.sent > SEND_MS) send(); };
    input.onchange = () => { slider.until = performance.now() + HOLD_MS; send(); };
    this.jointList.append(box);
    return slider;
  }
}
