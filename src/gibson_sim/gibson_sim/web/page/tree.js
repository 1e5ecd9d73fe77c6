// The scene as a tree: robots, then the things of every floor by room, or all things, the nearest first. One row has the focus; arrow keys move it.
import { $, element, keyed, nameElement, remember, remembered } from './dom.js';

export const words = (name) => name.replaceAll('_', ' ');
const metres = (m) => (m < 10 ? m.toFixed(1) : m.toFixed(0)) + ' m';
const SLACK = 0.5; // metres: a room's outline is its free floor's; things stand at its walls

// Returns the name of the room of a thing: the one that its name begins with, else the smallest whose box has it; '' = none.
export function roomOf(thing, rooms) {
  const here = rooms.filter((room) => room.floor === thing.floor);
  const named = here.filter((room) => thing.name.startsWith(`${room.name}_`)).sort((a, b) => b.name.length - a.name.length)[0];
  if (named) return named.name;
  const size = (room) => (room.high[0] - room.low[0]) * (room.high[1] - room.low[1]);
  const inside = (room, slack) => thing.x > room.low[0] - slack && thing.x < room.high[0] + slack && thing.y > room.low[1] - slack && thing.y < room.high[1] + slack;
  for (const slack of [0, SLACK]) {
    const found = here.filter((room) => inside(room, slack)).sort((a, b) => size(a) - size(b))[0];
    if (found) return found.name;
  }
  return '';
}

export class Tree {
  // send: request to the server; select(name): a row was chosen.
  constructor(send, select) {
    this.send = send; this.onSelect = select; this.entities = []; this.doors = []; this.rooms = []; this.floors = 1; this.robot = null; this.selected = ''; this.focus = '';
    this.closed = new Set(remembered('closed-rooms', [])); this.grouping = remembered('grouping', 'rooms');
    $('grouping').value = this.grouping;
    $('grouping').onchange = () => { this.grouping = $('grouping').value; remember('grouping', this.grouping); this.draw(); };
    $('search').oninput = () => this.draw();
    $('tree').onkeydown = (event) => this.keyed(event);
    $('tree').onclick = (event) => { const row = event.target.closest('[role=treeitem]'); if (row && !event.target.closest('button')) { this.focus = row.dataset.key; this.activate(row); } };
  }

  setEntities(entities) { this.entities = entities; this.draw(); }
  setDoors(doors) { this.doors = doors; this.draw(); }
  setRooms(rooms) { this.rooms = rooms; this.draw(); }
  setFloors(count) { this.floors = count; this.draw(); }
  setRobot(robot) {
    const moved = !this.robot || !robot || Math.hypot(robot.x - this.robot.x, robot.y - this.robot.y) > 0.25 || robot.floor !== this.robot.floor || robot.namespace !== this.robot.namespace;
    if (moved) { this.robot = robot && { ...robot }; this.draw(); }
  }

  select(name) {
    this.selected = name; this.focus = `e:${name}`;
    const entity = this.entities.find((e) => e.name === name);
    if (entity && !entity.robot && this.grouping === 'rooms') this.closed.delete(this.keyOfRoom(entity));
    this.paint();
    $('tree').querySelector('[aria-selected=true]')?.scrollIntoView({ block: 'nearest' });
  }

  keyOfRoom(entity) { return `g:${entity.floor}/${roomOf(entity, this.rooms)}`; }

  distance(item) { return this.robot ? Math.hypot(item.x - this.robot.x, item.y - this.robot.y) : 0; }

  draw() { if (!this.pending) { this.pending = true; requestAnimationFrame(() => { this.pending = false; this.paint(); }); } }

  // Returns the rows: [key, level, text, item, number of items, whether it is open].
  rows() {
    const sought = $('search').value.trim().toLowerCase(), fits = (e) => !sought || [e.name, words(e.name), e.class, roomOf(e, this.rooms)].some((text) => text?.toLowerCase().includes(sought));
    const found = this.entities.filter(fits), rows = [], add = (e, level) => rows.push({ key: `e:${e.name}`, level, entity: e });
    const groupRow = (key, level, text, count) => { const open = Boolean(sought) || !this.closed.has(key); rows.push({ key, level, text, count, open }); return open; };
    const robots = found.filter((e) => e.robot), things = found.filter((e) => !e.robot);
    if (robots.length && groupRow('g:robots', 1, 'Robots', robots.length)) robots.forEach((e) => add(e, 2));
    if (this.grouping === 'nearest') {
      const apart = (e) => (this.robot && e.floor !== this.robot.floor ? 1e4 : 0) + this.distance(e);
      things.sort((a, b) => apart(a) - apart(b)).forEach((e) => add(e, 1));
      return rows;
    }
    const floors = [...new Set(things.map((e) => e.floor))].sort((a, b) => a - b);
    for (const floor of floors) {
      const here = things.filter((e) => e.floor === floor), rooms = new Map();
      const base = this.floors > 1 ? 2 : 1;
      if (base === 2 && !groupRow(`g:${floor}`, 1, `Floor ${floor}`, here.length)) continue;
      for (const e of here) { const room = roomOf(e, this.rooms); if (!rooms.has(room)) rooms.set(room, []); rooms.get(room).push(e); }
      for (const room of [...rooms.keys()].sort((a, b) => (a === '') - (b === '') || a.localeCompare(b))) {
        const items = rooms.get(room).sort((a, b) => this.isDoor(b) - this.isDoor(a) || a.name.localeCompare(b.name));
        if (groupRow(`g:${floor}/${room}`, base, room ? words(room) : this.rooms.length ? 'elsewhere' : 'things', items.length)) items.forEach((e) => add(e, base + 1));
      }
    }
    return rows;
  }

  jointsOf(entity) { return this.doors.filter((d) => d.joint.startsWith(`${entity.name}/`)); }
  isDoor(entity) { return this.jointsOf(entity).length > 0; }

  paint() {
    const rows = this.rows(), hadFocus = $('tree').contains(document.activeElement);
    $('tree-empty').hidden = rows.length > 0;
    $('tree-empty').textContent = this.entities.length ? 'Nothing has this name or class.' : 'No simulation, or nothing in it.';
    if (!rows.some((row) => row.key === this.focus)) this.focus = rows[0]?.key ?? '';
    keyed($('tree'), rows, (row) => row.key, (row) => {
      const div = element('div');
      div.setAttribute('role', 'treeitem');
      div.append(element('i', '', { className: 'mark' }), row.entity ? nameElement(row.entity.name) : element('span', row.text), element('small'));
      return div;
    }, (div, row) => {
      div.setAttribute('aria-level', row.level); div.style.setProperty('--level', row.level);
      div.tabIndex = row.key === this.focus ? 0 : -1;
      const [mark, name, small] = div.children;
      if (!row.entity) {
        div.className = 'branch'; div.setAttribute('aria-expanded', row.open); name.textContent = row.text; small.textContent = row.count;
        return;
      }
      const e = row.entity, joints = this.jointsOf(e), room = this.grouping === 'rooms' ? roomOf(e, this.rooms) : '';
      const short = room && e.name.startsWith(`${room}_`) ? e.name.slice(room.length + 1) : e.name;
      if (name.textContent !== short) name.replaceChildren(...nameElement(short).childNodes);
      div.title = e.class ? `${e.name}: ${e.class}` : e.name;
      div.setAttribute('aria-selected', e.name === this.selected);
      mark.className = `mark ${e.robot ? 'robot' : joints.length ? 'door' : 'thing'}`;
      small.textContent = e.robot ? '' : this.robot && e.floor !== this.robot.floor && this.grouping === 'nearest' ? `floor ${e.floor}` : this.robot ? metres(this.distance(e)) : '';
      this.paintJoint(div, joints);
    });
    if (hadFocus && !$('tree').contains(document.activeElement)) this.refocus(); // rows that moved have lost it
  }

  // Shows the opening of a door, and a button, for a body with one joint.
  paintJoint(div, joints) {
    let [bar, button] = [div.children[3], div.children[4]];
    if (joints.length !== 1) { bar?.remove(); button?.remove(); return; }
    if (!bar) { bar = element('i', '', { className: 'bar' }); button = element('button', '', { tabIndex: -1 }); div.append(bar, button); }
    const [d] = joints, open = (d.moving ?? d.opening) > 0.5;
    bar.style.setProperty('--part', d.opening); bar.title = `${Math.round(100 * d.opening)} % open`;
    button.textContent = open ? 'Close' : 'Open';
    button.setAttribute('aria-label', `${button.textContent} ${d.joint}`);
    button.onclick = () => this.send('open', { joint: d.joint, opening: open ? 0 : 1 });
  }

  activate(row) {
    const key = row.dataset.key;
    if (key.startsWith('e:')) this.onSelect(key.slice(2));
    else { this.closed.has(key) ? this.closed.delete(key) : this.closed.add(key); remember('closed-rooms', [...this.closed]); this.paint(); }
    this.refocus();
  }

  refocus() { [...$('tree').children].find((row) => row.dataset.key === this.focus)?.focus({ preventScroll: false }); }

  keyed(event) {
    const rows = [...$('tree').children], at = rows.findIndex((row) => row.dataset.key === this.focus), row = rows[at];
    if (!row || event.target.closest('button')) return;
    const isBranch = row.classList.contains('branch'), open = row.getAttribute('aria-expanded') === 'true', level = Number(row.getAttribute('aria-level'));
    const to = (k) => { if (rows[k]) { this.focus = rows[k].dataset.key; this.paint(); this.refocus(); } };
    if (event.key === 'ArrowDown') to(at + 1);
    else if (event.key === 'ArrowUp') to(at - 1);
    else if (event.key === 'Home') to(0);
    else if (event.key === 'End') to(rows.length - 1);
    else if (event.key === 'ArrowRight' && isBranch) open ? to(at + 1) : this.activate(row);
    else if (event.key === 'ArrowLeft') { if (isBranch && open) this.activate(row); else to(rows.slice(0, at).findLastIndex((r) => Number(r.getAttribute('aria-level')) < level)); }
    else if (event.key === 'Enter' || event.key === ' ') this.activate(row);
    else return;
    event.preventDefault();
  }
}
