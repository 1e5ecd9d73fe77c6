// The lists and buttons beside the map: doors, objects, recording, task, diagnostics.
import { $, element, keyed, nameElement } from './dom.js';

const words = (name) => name.replaceAll('_', ' ');
const furniture = (name) => words(name).replace(/ (drawers|doors|body)$/, '');
const metres = (m) => (m < 10 ? m.toFixed(1) : m.toFixed(0)) + ' m';
const size = (bytes) => (bytes < 1e6 ? `${Math.round(bytes / 1e3)} kB` : bytes < 1e9 ? `${(bytes / 1e6).toFixed(1)} MB` : `${(bytes / 1e9).toFixed(2)} GB`);
const clock = (s) => `${Math.floor(s / 60)}:${String(s % 60).padStart(2, '0')}`;
const LEVELS = ['ok', 'warning', 'error', 'stale'];

export class Panels {
  constructor(send, onSelect) {
    this.send = send; this.onSelect = onSelect; this.selected = ''; this.entities = []; this.doors = []; this.robot = null;
    $('record').onclick = () => send('record', this.recording?.on ? { action: 'stop' } : { action: 'start', images: $('record-images').checked });
    $('task-start').onclick = () => send('task', { action: 'start', task: $('task-name').value, baseline: $('task-baseline').value, seed: Number($('task-seed').value) || 0 });
    $('task-next').onclick = () => send('task', { action: 'next' });
    $('task-stop').onclick = () => send('task', { action: 'stop' });
  }

  distance(item) { return this.robot ? Math.hypot(item.x - this.robot.x, item.y - this.robot.y) : 0; }

  // Orders items by distance, those on the robot's floor first.
  nearer(a, b) { return (this.robot ? (a.floor !== this.robot.floor) - (b.floor !== this.robot.floor) : 0) || this.distance(a) - this.distance(b); }

  where(item) { return !this.robot ? '' : item.floor === this.robot.floor ? metres(this.distance(item)) : `floor ${item.floor}`; }

  setRobot(robot) {
    const moved = !this.robot || !robot || Math.hypot(robot.x - this.robot.x, robot.y - this.robot.y) > 0.1 || robot.namespace !== this.robot.namespace || robot.floor !== this.robot.floor;
    if (!moved) return;
    this.robot = robot && { ...robot };
    this.showDoors(); this.showThings();
  }

  setDoors(doors) { this.doors = doors; this.showDoors(); }

  // Doors and drawers, nearest first.
  showDoors() {
    $('doors-panel').hidden = !this.doors.length;
    const sorted = [...this.doors].sort((a, b) => this.nearer(a, b) || a.joint.localeCompare(b.joint));
    keyed($('doors'), sorted, (d) => d.joint, (d) => {
      const li = element('li'), bar = element('i', '', { className: 'bar' }), button = element('button');
      const [body, joint] = d.joint.split('/');
      const several = this.doors.filter((other) => other.joint.startsWith(`${body}/`)).length > 1;
      li.append(element('span', several ? `${furniture(body)}: ${words(joint)}` : furniture(body)), element('small'), bar, button);
      li.title = d.joint;
      return li;
    }, (li, d) => {
      const [, small, bar, button] = li.children, open = (d.moving ?? d.opening) > 0.5;
      small.textContent = this.where(d);
      bar.style.setProperty('--part', d.opening); bar.title = `${Math.round(100 * d.opening)} % open`;
      button.textContent = open ? 'Close' : 'Open';
      button.onclick = () => this.send('open', { joint: d.joint, opening: open ? 0 : 1 });
    });
  }

  setEntities(entities) { this.entities = entities; this.showThings(); }

  select(name) { this.selected = name; this.showThings(); this.onSelect(name); $('things').querySelector('[aria-selected=true]')?.scrollIntoView({ block: 'nearest' }); }

  // Objects, nearest first; × asks for confirmation before deleting.
  showThings() {
    const sorted = [...this.entities].sort((a, b) => b.robot - a.robot || this.nearer(a, b));
    $('things-empty').hidden = this.entities.length > 0;
    keyed($('things'), sorted, (e) => e.name, (e) => {
      const li = element('li'), small = element('small'), remove = element('button', '×', { title: `delete ${e.name}` });
      li.append(nameElement(e.name), small);
      li.onclick = () => this.select(e.name);
      if (!e.robot) li.append(remove);
      remove.onclick = (event) => {
        event.stopPropagation();
        if (remove.classList.contains('sure')) { this.send('delete', { name: e.name }); return; }
        remove.classList.add('sure'); remove.textContent = 'delete?';
        setTimeout(() => { remove.classList.remove('sure'); remove.textContent = '×'; }, 3000);
      };
      return li;
    }, (li, e) => { li.setAttribute('aria-selected', e.name === this.selected); li.children[1].textContent = e.robot ? '' : this.where(e); });
  }

  setRecording(r) {
    this.recording = r;
    $('record').textContent = r.on ? 'Stop' : 'Record';
    $('record').classList.toggle('on', r.on);
    $('record-images').disabled = r.on;
    $('record-what').textContent = r.on && r.seconds === null ? 'Starting: nothing is recorded yet …' : r.on || r.bytes ? `${r.folder}: ${size(r.bytes)}${r.seconds === null ? '' : `, ${clock(r.seconds)}`}` : r.error ? '' : 'A rosbag2 folder on the server.';
    $('record-error').textContent = r.error;
  }

  setTask(t) {
    const info = t.info, result = t.result, ended = 'success' in result;
    $('task-form').hidden = t.running || t.there;
    $('task-next').hidden = !t.there; $('task-stop').hidden = !t.running;
    $('task-text').textContent = info.task ? `${info.task}, seed ${info.seed}: ${info.text || ''}` : t.running ? 'Setting up …' : '';
    $('task-result').textContent = ended ? `${result.success ? 'Succeeded' : 'Failed'} after ${Number(result.time ?? 0).toFixed(1)} s` : t.there ? `Running; time limit ${Number(info.time_limit ?? 0).toFixed(0)} s` : '';
    $('task-result').className = ended ? (result.success ? 'good' : 'bad') : '';
    const rows = ended ? Object.entries(result).filter(([k, v]) => typeof v === 'number' && !['seed', 'time'].includes(k)) : [];
    $('task-score').replaceChildren(...rows.map(([k, v]) => { const li = element('li'); li.append(element('span', words(k)), element('b', String(Number(v.toFixed(2))))); return li; }));
    $('task-error').textContent = t.error;
  }

  setDiagnostics(diagnostics) {
    $('diagnostics-empty').hidden = diagnostics.length > 0;
    const worst = Math.max(0, ...diagnostics.map((d) => (d.level < 3 ? d.level : 0)));
    $('health').className = `dot level${worst}`; $('health').title = LEVELS[worst];
    keyed($('diagnostics'), diagnostics, (d) => d.name, (d) => { const li = element('li'); li.append(nameElement(d.name.replace(/^gibson_sim: /, '')), element('small')); return li; }, (li, d) => {
      li.className = `level${d.level}`;
      li.children[1].textContent = d.message;
      li.title = d.values.map(([k, v]) => `${k}: ${v}`).join('\n');
    });
  }
}
