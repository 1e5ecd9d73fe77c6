// The map: occupancy grid, robots, scan, path, named places and things, in metres; x right and y up at first.

export class FloorMap {
  constructor(canvas, onPlace) {
    this.canvas = canvas; this.context = canvas.getContext('2d'); this.onPlace = onPlace;
    this.mode = 'look'; this.grid = null; this.robots = []; this.scan = []; this.path = []; this.places = []; this.entities = [];
    this.estimate = null; this.selected = ''; this.view = null; this.drag = null; this.pending = false;
    new ResizeObserver(() => { this.view = null; this.draw(); }).observe(canvas);
    canvas.onpointerdown = (event) => this.down(event);
    canvas.onpointermove = (event) => this.move(event);
    canvas.onpointerup = (event) => this.up(event);
    canvas.onpointercancel = () => { this.drag = null; this.draw(); };
    canvas.onwheel = (event) => { event.preventDefault(); this.zoom(event.offsetX, event.offsetY, Math.exp(-event.deltaY * 0.0015)); };
  }

  async setMap(value) {
    const response = await fetch(`/data/${value.data}?${value.version}`);
    if (!response.ok) return;
    const picture = await createImageBitmap(new Blob([await response.arrayBuffer()], { type: 'image/png' }));
    const other = !this.grid || this.grid.width !== value.width || this.grid.height !== value.height;
    this.grid = { ...value, picture };
    if (other) this.view = null;
    this.draw();
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
    const [x0, y0, x1, y1] = this.bounds(), w = this.canvas.clientWidth, h = this.canvas.clientHeight;
    const scale = 0.96 * Math.min(w / (x1 - x0), h / (y1 - y0));
    this.view = { scale, x: (x0 + x1) / 2, y: (y0 + y1) / 2 };
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
    const [x, y] = this.world(px, py);
    this.view.scale = Math.max(2, Math.min(2000, this.view.scale * factor));
    const [nx, ny] = this.world(px, py);
    this.view.x += x - nx; this.view.y += y - ny;
    this.draw();
  }

  down(event) {
    if (!this.view) return;
    this.canvas.setPointerCapture(event.pointerId);
    const [x, y] = this.world(event.offsetX, event.offsetY);
    this.drag = { px: event.offsetX, py: event.offsetY, x, y, vx: this.view.x, vy: this.view.y, to: [x, y] };
  }

  move(event) {
    if (!this.drag) return;
    if (this.mode === 'look') {
      this.view.x = this.drag.vx - (event.offsetX - this.drag.px) / this.view.scale;
      this.view.y = this.drag.vy + (event.offsetY - this.drag.py) / this.view.scale;
    } else this.drag.to = this.world(event.offsetX, event.offsetY);
    this.draw();
  }

  up() {
    const drag = this.drag;
    this.drag = null;
    if (drag && this.mode !== 'look') {
      const dx = drag.to[0] - drag.x, dy = drag.to[1] - drag.y, far = Math.hypot(dx, dy) * this.view.scale > 8;
      this.onPlace({ x: drag.x, y: drag.y, yaw: far ? Math.atan2(dy, dx) : 0 });
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
    const style = getComputedStyle(document.documentElement), color = (name) => style.getPropertyValue(name).trim();
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.clearRect(0, 0, w, h);
    if (this.grid) {
      const g = this.grid, [x, y] = this.screen(g.x, g.y + g.height * g.resolution), size = g.resolution * this.view.scale;
      c.imageSmoothingEnabled = size < 1;
      c.drawImage(g.picture, x, y, g.width * size, g.height * size);
    }
    c.font = '12px system-ui, sans-serif';
    for (const p of this.places) {
      if (p.name.includes('/') && this.view.scale < 90) continue; // computed ones: rooms and starts first
      const [x, y] = this.screen(p.x, p.y);
      c.fillStyle = color('--soft'); c.beginPath(); c.arc(x, y, 2.5, 0, 7); c.fill();
      if (this.view.scale > 25) c.fillText(p.name, x + 5, y - 4);
    }
    if (this.path.length > 1) {
      c.strokeStyle = color('--good'); c.lineWidth = 2.5; c.beginPath();
      this.path.forEach(([px, py], k) => { const [x, y] = this.screen(px, py); k ? c.lineTo(x, y) : c.moveTo(x, y); });
      c.stroke();
    }
    c.fillStyle = color('--bad');
    for (const [px, py] of this.scan) { const [x, y] = this.screen(px, py); c.fillRect(x - 1, y - 1, 2.5, 2.5); }
    for (const e of this.entities) {
      if (e.robot) continue;
      const [x, y] = this.screen(e.x, e.y);
      c.strokeStyle = color('--accent'); c.lineWidth = e.name === this.selected ? 3 : 1.2;
      c.strokeRect(x - 4, y - 4, 8, 8);
      if (e.name === this.selected) { c.fillStyle = color('--accent'); c.fillText(e.name, x + 8, y + 4); }
    }
    if (this.estimate) {
      const e = this.estimate, [x, y] = this.screen(e.x, e.y);
      c.strokeStyle = color('--warn'); c.lineWidth = 1.5; c.beginPath();
      c.ellipse(x, y, Math.max(2, e.major * this.view.scale), Math.max(2, e.minor * this.view.scale), -e.angle, 0, 7); c.stroke();
    }
    for (const r of this.robots) this.arrow(r.x, r.y, r.yaw, Math.max(9, r.radius * this.view.scale), color('--accent'), true);
    if (this.drag && this.mode !== 'look') {
      const d = this.drag, yaw = Math.atan2(d.to[1] - d.y, d.to[0] - d.x);
      this.arrow(d.x, d.y, yaw, 14, color('--good'), false);
    }
  }

  arrow(wx, wy, yaw, size, color, filled) {
    const c = this.context, [x, y] = this.screen(wx, wy);
    c.save(); c.translate(x, y); c.rotate(-yaw);
    c.beginPath(); c.moveTo(size, 0); c.lineTo(-size * 0.7, size * 0.65); c.lineTo(-size * 0.4, 0); c.lineTo(-size * 0.7, -size * 0.65); c.closePath();
    c.lineWidth = 2; c.strokeStyle = '#fff'; c.fillStyle = color;
    if (filled) { c.fill(); c.stroke(); } else { c.strokeStyle = color; c.stroke(); }
    c.restore();
  }
}
