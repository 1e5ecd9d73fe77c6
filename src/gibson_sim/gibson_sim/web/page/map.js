// The map: occupancy grid, robots, scan, paths, named poses, doors and objects, in metres; initially x right and y up.

const MAX_TINTED = 16e6; // largest number of cells of a map drawn in the colours of the page
const CLICK = 5, NEAR = 12; // pixels: a press that moves less is a click; radius in which a click selects an object
const KEYS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }, PAN = 60; // pixels that an arrow key pans by
const MARKED = 0, ROBOT = 1, ROOM = 2, THING = 3, COMPUTED = 4; // ranks of labels: where two would overlap, the lower one is written
const dark = matchMedia('(prefers-color-scheme: dark)');

export class FloorMap {
  // on.place(pose): a click with a tool; on.select(name): a click on a thing; on.move(entity, x, y): a thing was dragged to there, m.
  constructor(canvas, on) {
    this.canvas = canvas; this.context = canvas.getContext('2d'); this.on = on;
    this.mode = 'look'; this.grid = null; this.grids = []; this.floors = [{ z: 0, map: null }]; this.shown = 0; this.followed = true; this.robots = []; this.scan = []; this.paths = []; this.places = []; this.entities = []; this.doors = [];
    this.rooms = []; this.estimates = []; this.target = null; this.selected = ''; this.chosen = ''; this.view = null; this.drag = null; this.cursor = null; this.hover = ''; this.pending = false;
    this.pointers = new Map(); this.labels = []; this.marks = [];
    new ResizeObserver(() => { if (!this.moved) this.view = null; this.draw(); }).observe(canvas);
    canvas.onpointerdown = (event) => this.down(event);
    canvas.onpointermove = (event) => this.move(event);
    canvas.onpointerup = (event) => this.up(event);
    canvas.onpointercancel = (event) => { this.pointers.delete(event.pointerId); this.drag = null; this.draw(); };
    canvas.onpointerleave = () => { this.cursor = null; this.hover = ''; this.draw(); };
    canvas.onkeydown = (event) => this.key(event);
    canvas.onfocus = canvas.onblur = () => this.draw();
    canvas.onwheel = (event) => { event.preventDefault(); this.zoom(event.offsetX, event.offsetY, Math.exp(-event.deltaY * 0.0015)); };
    dark.addEventListener('change', () => { for (const g of this.grids) if (g) g.tinted = null; this.show(this.shown); });
  }

  color(name) { return getComputedStyle(document.documentElement).getPropertyValue(name).trim(); }

  // Sets the floors, the lowest first: height and map, or null.
  async setFloors(floors) {
    this.floors = floors;
    if (this.shown >= floors.length) this.shown = 0;
    const known = new Map(this.grids.filter(Boolean).map((g) => [g.version, g]));
    const grids = await Promise.all(floors.map((f) => f.map && (known.get(f.map.version) || this.load(f.map))));
    if (this.floors === floors) { this.grids = grids; this.show(this.shown); } // else a later message was faster
  }

  async load(value) {
    const response = await fetch(`/data/${value.data}?${value.version}`);
    if (!response.ok) return null;
    const picture = await createImageBitmap(new Blob([await response.arrayBuffer()], { type: 'image/png' }));
    return { ...value, picture, tinted: null };
  }

  // Shows a floor.
  show(number) {
    const old = this.grid, grid = this.grids[number] || null;
    this.shown = number; this.grid = grid;
    if (grid && !grid.tinted) { grid.tinted = grid.picture; this.tint(); }
    // The view stays where it is if the floors have maps of the same size; floors of a house are compared so.
    if (!old || !grid || ['width', 'height', 'x', 'y', 'resolution'].some((key) => old[key] !== grid[key])) this.view = null;
    this.canvas.dataset.floor = number;
    this.draw();
  }

  // Returns those items that are on the shown floor.
  here(items) { return this.floors.length < 2 ? items : items.filter((item) => item.floor === this.shown); }

  // Draws free cells and obstacles in the colours of the page.
  tint() {
    const g = this.grid;
    if (!g || g.width * g.height > MAX_TINTED) return;
    const canvas = Object.assign(document.createElement('canvas'), { width: g.width, height: g.height }), c = canvas.getContext('2d', { willReadFrequently: true });
    const rgb = (name) => { c.fillStyle = this.color(name); c.fillRect(0, 0, 1, 1); return c.getImageData(0, 0, 1, 1).data.slice(0, 3); };
    const free = rgb('--floor'), wall = rgb('--wall');
    c.clearRect(0, 0, 1, 1);
    c.drawImage(g.picture, 0, 0);
    const image = c.getImageData(0, 0, g.width, g.height), d = image.data;
    for (let k = 0; k < d.length; k += 4) if (d[k + 3]) d.set(d[k] > 127 ? free : wall, k);
    c.putImageData(image, 0, 0);
    g.tinted = canvas;
  }

  // Returns whether the map has floor at a point; true without a map.
  hasFloor(x, y) {
    const g = this.grid;
    if (!g) return true;
    const column = Math.floor((x - g.x) / g.resolution), row = g.height - 1 - Math.floor((y - g.y) / g.resolution);
    if (column < 0 || row < 0 || column >= g.width || row >= g.height) return false;
    const canvas = Object.assign(document.createElement('canvas'), { width: 1, height: 1 }), c = canvas.getContext('2d');
    c.drawImage(g.picture, column, row, 1, 1, 0, 0, 1, 1);
    return c.getImageData(0, 0, 1, 1).data[3] > 0;
  }

  bounds() {
    if (this.grid) {
      const g = this.grid;
      return [g.x, g.y, g.x + g.width * g.resolution, g.y + g.height * g.resolution];
    }
    const xs = [...this.robots.map((r) => r.x), 0], ys = [...this.robots.map((r) => r.y), 0];
    return [Math.min(...xs) - 5, Math.min(...ys) - 5, Math.max(...xs) + 5, Math.max(...ys) + 5];
  }

  fit() {
    this.moved = false;
    const [x0, y0, x1, y1] = this.bounds(), w = this.canvas.clientWidth, h = this.canvas.clientHeight;
    const scale = 0.96 * Math.min(w / (x1 - x0), (h - 24) / (y1 - y0));
    this.view = { scale, x: (x0 + x1) / 2, y: (y0 + y1) / 2 - 10 / scale };
    this.draw();
  }

  world(px, py) {
    const v = this.view;
    return [v.x + (px - this.canvas.clientWidth / 2) / v.scale, v.y - (py - this.canvas.clientHeight / 2) / v.scale];
  }

  screen(x, y) {
    const v = this.view;
    return [this.canvas.clientWidth / 2 + (x - v.x) * v.scale, this.canvas.clientHeight / 2 - (y - v.y) * v.scale];
  }

  zoom(px, py, factor) {
    if (!this.view) return;
    this.moved = true;
    const [x, y] = this.world(px, py);
    this.view.scale = Math.max(2, Math.min(2000, this.view.scale * factor));
    const [nx, ny] = this.world(px, py);
    this.view.x += x - nx; this.view.y += y - ny;
    this.draw();
  }

  // Centres a point, m, and comes near enough to tell things apart.
  lookAt(x, y) {
    if (!this.view) this.fit();
    if (!this.view) return;
    this.moved = true;
    this.view = { scale: Math.max(this.view.scale, 90), x, y };
    this.draw();
  }

  // Returns the robot or thing selected by a click at a pixel; '' = none.
  thingAt(px, py) {
    let name = '', nearest = NEAR;
    for (const e of this.here(this.entities)) {
      const [x, y] = this.screen(e.x, e.y), d = Math.hypot(x - px, y - py);
      if (d < nearest) { name = e.name; nearest = d; }
    }
    return name;
  }

  // Pans, zooms, or acts at the centre.
  key(event) {
    if (!this.view) return;
    const middle = [this.canvas.clientWidth / 2, this.canvas.clientHeight / 2], step = KEYS[event.key];
    if (step) { this.moved = true; this.view.x += step[0] * PAN / this.view.scale; this.view.y += step[1] * PAN / this.view.scale; }
    else if (event.key === '+' || event.key === '=') this.zoom(...middle, 1.25);
    else if (event.key === '-') this.zoom(...middle, 0.8);
    else if (event.key === 'Enter' && this.mode !== 'look') this.on.place({ x: this.view.x, y: this.view.y, z: this.floors[this.shown].z, yaw: 0 });
    else if (event.key === 'Enter') { const name = this.thingAt(...middle); if (name) this.on.select(name); } else return;
    event.preventDefault();
    this.draw();
  }

  down(event) {
    if (!this.view) return;
    this.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, [event.offsetX, event.offsetY]);
    if (this.pointers.size > 1) { this.drag = null; return; }
    const [x, y] = this.world(event.offsetX, event.offsetY), name = this.mode === 'look' ? this.thingAt(event.offsetX, event.offsetY) : '';
    this.drag = { px: event.offsetX, py: event.offsetY, x, y, vx: this.view.x, vy: this.view.y, to: [x, y], thing: name && name === this.selected ? this.entities.find((e) => e.name === name) : null };
  }

  move(event) {
    if (!this.view) return;
    this.cursor = event.pointerType === 'touch' ? null : [event.offsetX, event.offsetY];
    const before = this.pointers.get(event.pointerId);
    if (before && this.pointers.size === 2) this.pinch(event, before);
    else if (this.drag?.thing) this.drag.to = this.world(event.offsetX, event.offsetY);
    else if (this.drag && this.mode === 'look') {
      this.moved ||= Math.hypot(event.offsetX - this.drag.px, event.offsetY - this.drag.py) > CLICK;
      this.view.x = this.drag.vx - (event.offsetX - this.drag.px) / this.view.scale;
      this.view.y = this.drag.vy + (event.offsetY - this.drag.py) / this.view.scale;
    } else if (this.drag) this.drag.to = this.world(event.offsetX, event.offsetY);
    if (before) this.pointers.set(event.pointerId, [event.offsetX, event.offsetY]);
    this.hover = this.cursor && !this.drag ? this.thingAt(...this.cursor) : '';
    this.canvas.classList.toggle('hit', this.mode === 'look' && Boolean(this.hover));
    this.canvas.classList.toggle('movable', this.mode === 'look' && Boolean(this.hover) && this.hover === this.selected);
    this.draw();
  }

  pinch(event, before) {
    const other = [...this.pointers].find(([id]) => id !== event.pointerId)[1];
    const was = Math.hypot(before[0] - other[0], before[1] - other[1]), is = Math.hypot(event.offsetX - other[0], event.offsetY - other[1]);
    if (was > 5 && is > 5) this.zoom((event.offsetX + other[0]) / 2, (event.offsetY + other[1]) / 2, is / was);
  }

  up(event) {
    const drag = this.drag, still = drag && Math.hypot(event.offsetX - drag.px, event.offsetY - drag.py) < CLICK;
    this.drag = null;
    this.pointers.delete(event.pointerId);
    if (drag && this.mode !== 'look') {
      const dx = drag.to[0] - drag.x, dy = drag.to[1] - drag.y, far = Math.hypot(dx, dy) * this.view.scale > 8;
      this.on.place({ x: drag.x, y: drag.y, z: this.floors[this.shown].z, yaw: far ? Math.atan2(dy, dx) : 0 });
    } else if (drag?.thing && !still) {
      this.on.move(drag.thing, drag.thing.x + drag.to[0] - drag.x, drag.thing.y + drag.to[1] - drag.y);
    } else if (still) {
      const name = this.thingAt(event.offsetX, event.offsetY);
      if (name) this.on.select(name);
    }
    this.draw();
  }

  draw() {
    if (this.pending) return;
    this.pending = true;
    requestAnimationFrame(() => { this.pending = false; this.paint(); });
  }

  paint() {
    const canvas = this.canvas, c = this.context, ratio = devicePixelRatio || 1, w = canvas.clientWidth, h = canvas.clientHeight;
    if (!w || !h) return;
    if (canvas.width !== Math.round(w * ratio) || canvas.height !== Math.round(h * ratio)) { canvas.width = Math.round(w * ratio); canvas.height = Math.round(h * ratio); }
    if (!this.view) { this.fit(); return; }
    canvas.dataset.view = `${this.view.scale} ${this.view.x} ${this.view.y}`; // pixels per metre, and the point at the centre
    const style = getComputedStyle(document.documentElement), color = (name) => style.getPropertyValue(name).trim(), scale = this.view.scale;
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.clearRect(0, 0, w, h);
    c.textBaseline = 'alphabetic'; c.textAlign = 'left';
    if (this.grid) {
      const g = this.grid, [x, y] = this.screen(g.x, g.y + g.height * g.resolution), size = g.resolution * scale;
      c.imageSmoothingEnabled = size < 1;
      c.drawImage(g.tinted, x, y, g.width * size, g.height * size);
      canvas.dataset.map = g.version;
    }
    this.drawn = new Map();
    this.line(this.here(this.paths).map((p) => p.points), color('--path'));
    if (this.here(this.paths).length) this.drawn.set('path', 'path');
    c.fillStyle = color('--scan');
    for (const s of this.here(this.scan)) for (const [px, py] of s.points) { const [x, y] = this.screen(px, py); c.fillRect(x - 1, y - 1, 2.5, 2.5); this.drawn.set('scan', 'scan'); }
    this.labels = []; this.marks = [];
    c.font = '11px system-ui, sans-serif';
    for (const e of this.here(this.entities)) this.thing(e, color);
    for (const d of this.here(this.doors)) this.door(d, color);
    for (const r of this.here(this.rooms)) this.room(r, color);
    for (const p of this.here(this.places)) this.place(p, color);
    for (const e of this.here(this.estimates)) {
      const [x, y] = this.screen(e.x, e.y);
      this.drawn.set('estimate', 'localiser, 2σ');
      c.strokeStyle = color('--estimate'); c.fillStyle = `${color('--estimate')}33`; c.lineWidth = 1.5; c.beginPath();
      c.ellipse(x, y, Math.max(2, e.major * scale), Math.max(2, e.minor * scale), -e.angle, 0, 7); c.fill(); c.stroke();
    }
    for (const r of this.here(this.robots)) {
      const mine = r.namespace === this.chosen || this.robots.length === 1;
      this.arrow(r.x, r.y, r.yaw, Math.max(9, r.radius * scale), color(mine ? '--accent' : '--soft'), true);
      this.mark(r.x, r.y, Math.max(9, r.radius * scale), true);
      this.drawn.set(mine ? 'robot' : 'other', mine ? 'robot' : 'other robot');
      if (this.robots.length > 1) this.label(r.name, r.x, r.y, Math.max(12, r.radius * scale + 4), color('--text'), ROBOT);
    }
    if (this.target && this.here([this.target]).length) { this.flag(...this.screen(this.target.x, this.target.y), color('--path')); this.drawn.set('goal', 'goal of the task'); }
    if (this.drag?.thing) this.ghost(this.drag, color('--accent'));
    if (document.activeElement === canvas && this.mode !== 'look' && canvas.matches(':focus-visible')) this.cross(w / 2, h / 2, color('--text'));
    if (this.drag && this.mode !== 'look') {
      const d = this.drag, yaw = Math.atan2(d.to[1] - d.y, d.to[0] - d.x);
      this.arrow(d.x, d.y, yaw, 14, color('--path'), false);
    }
    this.writeLabels(w, h, color('--floor'));
    this.scaleBar(w, h, color);
    this.on.drawn?.(this.drawn);
  }

  // Draws the symbol of a kind of item in a canvas of 18 x 14 pixels, for the legend, as the map draws it.
  symbol(kind, canvas) {
    const own = [this.context, this.view], style = getComputedStyle(document.documentElement), color = (name) => style.getPropertyValue(name).trim(), ratio = devicePixelRatio || 1;
    canvas.width = 18 * ratio; canvas.height = 14 * ratio;
    const c = this.context = canvas.getContext('2d');
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.screen = (x, y) => [9 + x, 7 - y]; // one metre is one pixel
    if (kind === 'robot' || kind === 'other') this.arrow(0, 0, 0, 8, color(kind === 'robot' ? '--accent' : '--soft'), true);
    if (kind === 'scan') { c.fillStyle = color('--scan'); for (const x of [3, 8, 13]) c.fillRect(x, 6, 2.5, 2.5); }
    if (kind === 'thing') this.square(9, 7, false, color);
    if (kind === 'door') this.disc(9, 7, 0.3, 1.4, color);
    if (kind === 'place') this.dot(9, 7, color);
    if (kind === 'path') this.line([[[-8, 0], [8, 0]]], color('--path'));
    if (kind === 'goal') this.flag(5, 13, color('--path'), 0.6);
    if (kind === 'estimate') { c.strokeStyle = color('--estimate'); c.fillStyle = `${color('--estimate')}33`; c.lineWidth = 1.5; c.beginPath(); c.ellipse(9, 7, 7, 4.5, 0, 0, 7); c.fill(); c.stroke(); }
    delete this.screen;
    [this.context, this.view] = own;
  }

  // Notes a symbol around a point (m), of a radius in pixels, which labels leave free: those of rooms where they can, or always for a robot.
  mark(x, y, radius, robot = false) { const [px, py] = this.screen(x, y); this.marks.push([px - radius, py - radius, px + radius, py + radius, robot]); }

  ghost(d, color) {
    const c = this.context, [x0, y0] = this.screen(d.thing.x, d.thing.y), [x, y] = this.screen(d.thing.x + d.to[0] - d.x, d.thing.y + d.to[1] - d.y);
    c.strokeStyle = color; c.lineWidth = 1.5; c.setLineDash([4, 3]);
    c.beginPath(); c.moveTo(x0, y0); c.lineTo(x, y); c.stroke(); c.strokeRect(x - 6, y - 6, 12, 12);
    c.setLineDash([]);
  }

  cross(x, y, color) {
    const c = this.context;
    c.strokeStyle = color; c.lineWidth = 1.5;
    c.beginPath(); c.moveTo(x - 10, y); c.lineTo(x + 10, y); c.moveTo(x, y - 10); c.lineTo(x, y + 10); c.stroke();
  }

  line(paths, color) {
    const c = this.context;
    c.strokeStyle = color; c.lineWidth = 2.5; c.beginPath();
    for (const path of paths) path.forEach(([px, py], k) => { const [x, y] = this.screen(px, py); k ? c.lineTo(x, y) : c.moveTo(x, y); });
    c.stroke();
  }

  // Notes a label of a point (m) to be written at `gap` pixels from it.
  label(text, x, y, gap, color, rank) { this.labels.push({ text, at: this.screen(x, y), gap, color, rank }); }

  // Writes the labels, the important ones first: to the right of their point, else to its left, above or below it, where it fits between those
  // written and the edges. A label that fits nowhere is left out, unless it is marked or of a robot.
  writeLabels(w, h, halo) {
    const c = this.context, written = [], names = [];
    const over = (box, marks) => marks.some((b) => box[0] < b[2] && box[2] > b[0] && box[1] < b[3] && box[3] > b[1]), robots = this.marks.filter((b) => b[4]);
    for (const l of this.labels.sort((a, b) => a.rank - b.rank)) {
      const [x, y] = l.at, width = c.measureText(l.text).width;
      if (x < -width - l.gap || y < -20 || x > w + width + l.gap || y > h + 20) continue;
      const boxes = [[x + l.gap, y], [x - l.gap - width, y], [x - width / 2, y - l.gap - 10], [x - width / 2, y + l.gap + 10]].map(([left, middle]) => [left, middle - 7, left + width, middle + 7]);
      const fits = (box) => box[0] >= 0 && box[1] >= 0 && box[2] <= w && box[3] <= h && !over(box, written);
      const box = boxes.find((b) => fits(b) && !over(b, this.marks)) || (l.rank <= ROOM && boxes.find((b) => fits(b) && !over(b, robots))) || (l.rank <= ROBOT ? boxes[0] : null);
      if (!box) continue;
      written.push(box); names.push(l.text);
      c.globalAlpha = 0.82; c.fillStyle = halo; c.beginPath(); c.roundRect(box[0] - 2, box[1], width + 4, 14, 3); c.fill(); c.globalAlpha = 1;
      c.fillStyle = l.color; c.fillText(l.text, box[0], box[1] + 11);
    }
    this.canvas.dataset.labels = names.join('\n');
  }

  thing(e, color) {
    if (e.robot || this.doors.some((d) => d.joint.startsWith(`${e.name}/`))) return;
    const [x, y] = this.screen(e.x, e.y), selected = e.name === this.selected, marked = selected || e.name === this.hover;
    this.square(x, y, selected, color, marked);
    this.mark(e.x, e.y, 4); this.drawn.set('thing', 'thing');
    if (marked || this.view.scale > 70) this.label(e.name, e.x, e.y, 8, color(marked ? '--text' : '--accent'), marked ? MARKED : THING);
  }

  square(x, y, selected, color, marked = false) {
    const c = this.context;
    c.strokeStyle = color('--accent'); c.fillStyle = selected ? color('--accent') : color('--thing'); c.lineWidth = marked ? 2.5 : 1.4;
    c.fillRect(x - 4, y - 4, 8, 8); c.strokeRect(x - 4, y - 4, 8, 8);
  }

  // Draws a door or a drawer: a disc filled in proportion to the opening.
  door(d, color) {
    const [x, y] = this.screen(d.x, d.y), body = d.joint.split('/')[0], marked = body === this.selected || body === this.hover;
    this.disc(x, y, d.opening, marked ? 3 : 1.4, color);
    this.mark(d.x, d.y, 5); this.drawn.set('door', 'door, drawer');
    if (marked || this.view.scale > 70) this.label(body, d.x, d.y, 9, color(marked ? '--text' : '--door'), marked ? MARKED : THING);
  }

  disc(x, y, opening, width, color) {
    const c = this.context;
    c.beginPath(); c.arc(x, y, 5, 0, 7); c.fillStyle = color('--card'); c.fill();
    c.beginPath(); c.moveTo(x, y); c.arc(x, y, 5, -Math.PI / 2, -Math.PI / 2 + 2 * Math.PI * Math.max(0, Math.min(1, opening))); c.fillStyle = color('--door'); c.fill();
    c.beginPath(); c.arc(x, y, 5, 0, 7); c.strokeStyle = color('--door'); c.lineWidth = width; c.stroke();
  }

  room(r, color) {
    const x = (r.low[0] + r.high[0]) / 2, y = (r.low[1] + r.high[1]) / 2;
    if (this.view.scale > 9) this.label(r.name.replaceAll('_', ' '), x, y, -this.context.measureText(r.name).width / 2, color('--soft'), ROOM);
  }

  place(p, color) {
    if (p.name.includes('/') && (this.view.scale < 90 || this.rooms.some((r) => p.name.endsWith(`/${r.name}`)))) return; // computed poses: rooms and starts have priority
    this.dot(...this.screen(p.x, p.y), color);
    this.drawn.set('place', 'named pose');
    if (this.view.scale > 9 && !this.rooms.some((r) => r.name === p.name)) this.label(p.name, p.x, p.y, 5, color('--soft'), p.name.includes('/') ? COMPUTED : ROOM);
  }

  dot(x, y, color) { const c = this.context; c.fillStyle = color('--soft'); c.beginPath(); c.arc(x, y, 2.5, 0, 7); c.fill(); }

  flag(x, y, color, size = 1) {
    const c = this.context;
    c.strokeStyle = c.fillStyle = color; c.lineWidth = 2;
    c.beginPath(); c.moveTo(x, y); c.lineTo(x, y - 20 * size); c.stroke();
    c.beginPath(); c.moveTo(x, y - 20 * size); c.lineTo(x + 12 * size, y - 15.5 * size); c.lineTo(x, y - 11 * size); c.fill();
    c.beginPath(); c.arc(x, y, 3 * size, 0, 7); c.fill();
  }

  scaleBar(w, h, color) {
    const c = this.context, length = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50].find((m) => m * this.view.scale >= 50) || 100, px = length * this.view.scale;
    c.strokeStyle = color('--text'); c.fillStyle = color('--text'); c.lineWidth = 1.5;
    c.beginPath(); c.moveTo(10, h - 14); c.lineTo(10, h - 9); c.lineTo(10 + px, h - 9); c.lineTo(10 + px, h - 14); c.stroke();
    c.textAlign = 'left'; c.fillText(`${length} m`, 15 + px, h - 8);
    if (!this.cursor) return;
    const [x, y] = this.world(...this.cursor);
    c.textAlign = 'right'; c.fillText(`x ${x.toFixed(2)}  y ${y.toFixed(2)} m`, w - 10, h - 8);
  }

  arrow(wx, wy, yaw, size, color, filled) {
    const c = this.context, [x, y] = this.screen(wx, wy);
    c.save(); c.translate(x, y); c.rotate(-yaw);
    c.beginPath(); c.moveTo(size, 0); c.lineTo(-size * 0.7, size * 0.65); c.lineTo(-size * 0.4, 0); c.lineTo(-size * 0.7, -size * 0.65); c.closePath();
    c.lineWidth = 1.5; c.strokeStyle = this.color('--floor'); c.fillStyle = color;
    if (filled) { c.fill(); c.stroke(); } else { c.strokeStyle = color; c.stroke(); }
    c.restore();
  }
}
