// The scene in 3-D, rendered with WebGL 2: orbit, pan and zoom, or follow a robot; select a body, drag it, or point at a place. World frame, metres, z up.

const VERTEX = `#version 300 es
uniform mat4 u_camera, u_link;
layout(location = 0) in vec3 a_position; layout(location = 1) in vec2 a_uv; layout(location = 2) in vec4 a_normal; layout(location = 3) in vec4 a_color;
out vec2 v_uv; out vec4 v_color; out vec3 v_normal; out float v_height;
void main() { vec4 place = u_link * vec4(a_position, 1.0); v_height = place.z; gl_Position = u_camera * place; v_uv = a_uv; v_color = a_color; v_normal = mat3(u_link) * a_normal.xyz; }`;
const FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D u_texture; uniform bool u_textured, u_unlit; uniform vec4 u_tint, u_number; uniform float u_cut;
in vec2 v_uv; in vec4 v_color; in vec3 v_normal; in float v_height; out vec4 color;
void main() {
  if (v_height > u_cut) discard;
  if (u_number.a > 0.0) { color = u_number; return; }
  color = v_color; if (u_textured) color *= texture(u_texture, v_uv);
  if (color.a < 0.05) discard;
  if (!u_unlit) color.rgb *= 0.62 + 0.38 * max(0.0, dot(normalize(v_normal), normalize(vec3(-0.35, -0.25, 0.9))));
  color.rgb = mix(color.rgb, u_tint.rgb, u_tint.a);
}`;
const BYTES = 28; // per vertex
const CLICK = 5; // pixels: a press that moves less is a click
const CUT = 2.2; // metres above the shown floor; what is higher is hidden
const BUDGET = 3; // the scene is drawn at most every BUDGET times as long as a drawing takes
const SLOW = 60, FAST = 20; // ms that a drawing takes: above, it is drawn with fewer pixels; below, with more
const COARSEST = 0.5; // smallest number of drawn pixels per pixel of the page, in each direction
const TURN = 0.12; // rad, of an arrow key
const UNIFORMS = ['u_camera', 'u_link', 'u_texture', 'u_textured', 'u_unlit', 'u_tint', 'u_number', 'u_cut'];

const multiply = (a, b) => { const o = new Float32Array(16); for (let c = 0; c < 4; c++) for (let r = 0; r < 4; r++) { let s = 0; for (let k = 0; k < 4; k++) s += a[k * 4 + r] * b[c * 4 + k]; o[c * 4 + r] = s; } return o; };
const perspective = (fov, aspect, near, far) => { const f = 1 / Math.tan(fov / 2), d = near - far; return new Float32Array([f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / d, -1, 0, 0, 2 * far * near / d, 0]); };
const normal = (v) => { const n = Math.hypot(...v) || 1; return v.map((x) => x / n); };
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
function lookAt(eye, target) {
  const z = normal(eye.map((e, k) => e - target[k])), x = normal(cross([0, 0, 1], z)), y = cross(z, x);
  return new Float32Array([x[0], y[0], z[0], 0, x[1], y[1], z[1], 0, x[2], y[2], z[2], 0, -dot(x, eye), -dot(y, eye), -dot(z, eye), 1]);
}
function fromPose(p, k) {
  const [x, y, z, qx, qy, qz, qw] = p.subarray(k * 7, k * 7 + 7);
  return new Float32Array([
    1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy + qz * qw), 2 * (qx * qz - qy * qw), 0, 2 * (qx * qy - qz * qw), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz + qx * qw), 0,
    2 * (qx * qz + qy * qw), 2 * (qy * qz - qx * qw), 1 - 2 * (qx * qx + qy * qy), 0, x, y, z, 1]);
}
const FIELD = 0.9; // vertical field of view, rad
const IDENTITY = new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);

// Returns whether WebGL is drawn by a GPU: in software, antialiasing costs several times as much.
function hasGpu() {
  const gl = document.createElement('canvas').getContext('webgl2'), info = gl?.getExtension('WEBGL_debug_renderer_info');
  const is = Boolean(gl) && !/swiftshader|llvmpipe|software/i.test(info ? gl.getParameter(info.UNMASKED_RENDERER_WEBGL) : '');
  gl?.getExtension('WEBGL_lose_context')?.loseContext();
  return is;
}

export class Scene3D {
  // on.ready(): a model was loaded; on.select(name), on.move(entity, x, y): a body was clicked, dragged to there, m; on.place(pose): a click with a
  // tool; on.drawn(): received poses are in view.
  constructor(canvas, on) {
    this.canvas = canvas; this.on = on; this.model = null; this.poses = null; this.again = false; this.follow = true; this.enabled = false; this.mode = 'look'; this.selected = ''; this.cuts = true; this.floorZ = 0;
    this.target = [0, 0, 0.5]; this.distance = 5; this.azimuth = Math.PI; this.elevation = 1; this.pending = false; this.pointers = new Map(); this.drag = null; this.earliest = 0; this.unshown = false;
    this.scale = 1;
    this.gl = undefined; // null = this browser has no WebGL 2
    canvas.oncontextmenu = (event) => event.preventDefault();
    canvas.onpointerdown = (event) => this.down(event);
    canvas.onpointerup = (event) => this.up(event);
    canvas.onpointercancel = (event) => { this.pointers.delete(event.pointerId); this.drag = null; this.draw(); };
    canvas.onpointermove = (event) => this.dragged(event);
    canvas.onwheel = (event) => { event.preventDefault(); this.zoom(Math.exp(event.deltaY * 0.0012)); };
    canvas.onkeydown = (event) => this.key(event);
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  // Makes the context, once the scene is in view: in software that takes longer than the first image.
  start() {
    this.gl = this.canvas.getContext('webgl2', { antialias: hasGpu() });
    if (this.gl) this.program = this.build();
  }

  build() {
    const gl = this.gl, program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text); gl.compileShader(shader); gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    this.at = Object.fromEntries(UNIFORMS.map((n) => [n, gl.getUniformLocation(program, n)]));
    return program;
  }

  // Sets whether the scene is in view; its model is downloaded once it is.
  enable(enabled) {
    this.enabled = enabled;
    if (enabled && this.gl === undefined) this.start();
    if (enabled && this.offered) this.load(this.offered);
    if (enabled) this.draw();
  }

  // Names the newest version of the model.
  offer(version) { this.offered = version; if (this.enabled) this.load(version); }

  async load(version) {
    if (!this.gl || this.version === version) return;
    this.version = version;
    const [model, arrays] = await Promise.all([fetch(`/data/scene?${version}`).then((r) => r.json()), fetch(`/data/scene_arrays?${version}`).then((r) => r.arrayBuffer())]);
    const gl = this.gl;
    this.free();
    const array = gl.createVertexArray(), vertices = gl.createBuffer(), indices = gl.createBuffer();
    gl.bindVertexArray(array);
    gl.bindBuffer(gl.ARRAY_BUFFER, vertices);
    gl.bufferData(gl.ARRAY_BUFFER, new Uint8Array(arrays, 0, model.vertices * BYTES), gl.STATIC_DRAW);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, indices);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint32Array(arrays, model.vertices * BYTES, model.indices), gl.STATIC_DRAW);
    for (const [k, size, type, scaled, offset] of [[0, 3, gl.FLOAT, false, 0], [1, 2, gl.FLOAT, false, 12], [2, 4, gl.BYTE, true, 20], [3, 4, gl.UNSIGNED_BYTE, true, 24]]) {
      gl.enableVertexAttribArray(k); gl.vertexAttribPointer(k, size, type, scaled, BYTES, offset);
    }
    gl.bindVertexArray(null);
    this.model = { ...model, array, vertices: vertices, indices: indices, textures: Array.from({ length: model.textures }, (_, k) => this.texture(k, version)) };
    this.names = model.links.map((link) => link.slice(0, link.lastIndexOf('/')));
    this.on.ready?.();
    this.draw();
  }

  texture(k, version) {
    const gl = this.gl, texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 1, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array([180, 180, 180, 255]));
    fetch(`/data/texture_${k}?${version}`).then((r) => r.blob()).then((b) => createImageBitmap(b)).then((bitmap) => {
      if (!gl.isTexture(texture)) return;
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, bitmap);
      gl.generateMipmap(gl.TEXTURE_2D);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
      bitmap.close(); this.draw();
    }).catch(() => {});
    return texture;
  }

  free() {
    if (!this.model) return;
    const gl = this.gl;
    this.model.textures.forEach((t) => gl.deleteTexture(t));
    gl.deleteBuffer(this.model.vertices); gl.deleteBuffer(this.model.indices); gl.deleteVertexArray(this.model.array);
    this.model = null;
  }

  setPoses(buffer) { this.poses = new Float32Array(buffer.slice(12)); this.unshown = true; if (!this.draw()) this.shown(); }

  // Says once that the poses are in view: the server sends the next ones then.
  shown() { if (this.unshown) { this.unshown = false; this.on.drawn?.(); } }

  setRobot(robot) {
    if (!this.follow || !robot || (this.target[0] === robot.x && this.target[1] === robot.y)) return;
    this.target = [robot.x, robot.y, robot.z + 0.5];
    this.draw();
  }

  setFloor(z) { if (z !== this.floorZ) { this.floorZ = z; if (!this.follow) this.target[2] = z + 0.5; this.draw(); } }

  lookAt(entity) { this.target = [entity.x, entity.y, entity.z]; this.distance = Math.min(this.distance, 3); this.draw(); }

  zoom(factor) { this.distance = Math.max(0.4, Math.min(80, this.distance * factor)); this.draw(); }

  turn(by, up) { this.azimuth += by; this.elevation = Math.max(-0.2, Math.min(1.55, this.elevation + up)); this.draw(); }

  key(event) {
    const turn = { ArrowLeft: [-TURN, 0], ArrowRight: [TURN, 0], ArrowUp: [0, TURN], ArrowDown: [0, -TURN] }[event.key];
    if (turn) this.turn(...turn);
    else if (event.key === '+' || event.key === '=') this.zoom(0.8);
    else if (event.key === '-') this.zoom(1.25);
    else if (event.key === 'Enter') this.act(this.canvas.clientWidth / 2, this.canvas.clientHeight / 2);
    else return;
    event.preventDefault();
  }

  down(event) {
    this.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, [event.offsetX, event.offsetY]);
    this.drag = null;
    if (this.pointers.size > 1) return;
    this.begin = [event.offsetX, event.offsetY];
    if (this.mode !== 'look' || event.shiftKey || event.button) return;
    const link = this.selected ? this.linkOf(this.selected) : -1;
    if (link < 0 || this.pick(event.offsetX, event.offsetY) !== this.selected) return;
    const z = this.poses[link * 7 + 2], from = this.ground(event.offsetX, event.offsetY, z);
    if (from) this.drag = { z, from, by: [0, 0] };
  }

  up(event) {
    const drag = this.drag, still = this.begin && this.pointers.size === 1 && Math.hypot(event.offsetX - this.begin[0], event.offsetY - this.begin[1]) < CLICK;
    this.pointers.delete(event.pointerId); this.drag = null;
    if (drag && !still) {
      const link = this.linkOf(this.selected), [x, y, z] = this.poses.subarray(link * 7, link * 7 + 3), [qx, qy, qz, qw] = this.poses.subarray(link * 7 + 3, link * 7 + 7);
      this.on.move({ name: this.selected, z, yaw: Math.atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz)) }, x + drag.by[0], y + drag.by[1]);
    } else if (still && event.button === 0) this.act(event.offsetX, event.offsetY);
    this.draw();
  }

  // Selects the body at a pixel, or points at the floor there.
  act(px, py) {
    if (this.mode === 'look') { const name = this.pick(px, py); if (name) this.on.select(name); return; }
    const at = this.ground(px, py, this.floorZ);
    if (at) this.on.place({ x: at[0], y: at[1], z: this.floorZ, yaw: 0 });
  }

  // Returns the first link of a body, its root; -1 = none.
  linkOf(name) { return this.poses && this.names ? this.names.indexOf(name) : -1; }

  dragged(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const dx = event.offsetX - before[0], dy = event.offsetY - before[1];
    if (this.pointers.size === 2) {
      const other = [...this.pointers.entries()].find(([id]) => id !== event.pointerId)[1];
      const was = Math.hypot(before[0] - other[0], before[1] - other[1]), is = Math.hypot(event.offsetX - other[0], event.offsetY - other[1]);
      if (is > 5) this.zoom(was / is);
    } else if (this.drag) {
      const to = this.ground(event.offsetX, event.offsetY, this.drag.z);
      if (to) this.drag.by = [to[0] - this.drag.from[0], to[1] - this.drag.from[1]];
    } else if (event.buttons & 2 || event.shiftKey) {
      const scale = this.distance / this.canvas.clientHeight, c = Math.cos(this.azimuth), s = Math.sin(this.azimuth);
      this.follow = false; document.getElementById('follow').setAttribute('aria-pressed', false);
      this.target[0] += (dx * s + dy * c) * -scale * -1; this.target[1] += (-dx * c + dy * s) * -scale * -1;
    } else this.turn(-dx * 0.008, dy * 0.008);
    this.pointers.set(event.pointerId, [event.offsetX, event.offsetY]);
    this.draw();
  }

  // Draws soon, but leaves most of the time to others: a drawing in software takes long. Returns false if nothing can be drawn.
  draw() {
    if (!this.gl || !this.enabled || !this.model || document.hidden || !this.canvas.clientWidth) return false;
    if (this.pending) { this.again = true; return true; }
    this.pending = true;
    setTimeout(() => requestAnimationFrame(() => this.paintNow()), Math.max(0, this.earliest - performance.now()));
    return true;
  }

  paintNow() {
    const gl = this.gl, begin = performance.now();
    this.paint();
    const fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    const done = () => {
      if (fence && gl.clientWaitSync(fence, 0, 0) === gl.TIMEOUT_EXPIRED) { requestAnimationFrame(done); return; }
      gl.deleteSync(fence);
      const now = performance.now(), took = Math.max(0, now - begin - 17); // 17 ms: one frame passes before the fence is asked
      this.earliest = now + Math.min(500, (BUDGET - 1) * took);
      const scale = took > SLOW ? Math.max(COARSEST, 0.8 * this.scale) : took < FAST ? Math.min(devicePixelRatio || 1, 1.25 * this.scale) : this.scale;
      if (scale !== this.scale) { this.scale = scale; this.again = true; }
      this.pending = false;
      this.shown();
      if (this.again) { this.again = false; this.draw(); }
    };
    requestAnimationFrame(done);
  }

  // Returns the eye and the matrix from the world to the picture.
  camera(aspect) {
    const ce = Math.cos(this.elevation);
    const eye = [this.target[0] + this.distance * ce * Math.cos(this.azimuth), this.target[1] + this.distance * ce * Math.sin(this.azimuth), this.target[2] + this.distance * Math.sin(this.elevation)];
    return { eye, matrix: multiply(perspective(FIELD, aspect, 0.05, 300), lookAt(eye, this.target)) };
  }

  // Returns x, y (m) of the horizontal plane at z that a pixel shows; null = none.
  ground(px, py, z) {
    const w = this.canvas.clientWidth, h = this.canvas.clientHeight, { eye } = this.camera(w / h), t = Math.tan(FIELD / 2);
    const back = normal(eye.map((e, k) => e - this.target[k])), right = normal(cross([0, 0, 1], back)), up = cross(back, right);
    const a = (2 * px / w - 1) * t * w / h, b = (1 - 2 * py / h) * t, ray = back.map((v, k) => -v + a * right[k] + b * up[k]);
    const s = (z - eye[2]) / ray[2];
    return s > 0 && s < 200 ? [eye[0] + s * ray[0], eye[1] + s * ray[1]] : null;
  }

  paint() {
    const gl = this.gl, canvas = this.canvas, w = Math.round(canvas.clientWidth * this.scale), h = Math.round(canvas.clientHeight * this.scale);
    if (!w || !h || !this.model) return;
    if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
    const [r, g, b] = this.model.background;
    gl.viewport(0, 0, w, h); gl.clearColor(r, g, b, 1); gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    this.drawBatches(w / h, null);
    canvas.dataset.drawn = Number(canvas.dataset.drawn || 0) + 1;
  }

  // Draws the scene, or with numbers the links in colours that number them, from 1.
  drawBatches(aspect, numbers) {
    const gl = this.gl, m = this.model;
    gl.enable(gl.DEPTH_TEST); gl.enable(gl.CULL_FACE); gl.cullFace(gl.BACK); // back-face culling makes walls between the camera and the room invisible
    gl.useProgram(this.program); gl.bindVertexArray(m.array);
    gl.uniformMatrix4fv(this.at.u_camera, false, this.camera(aspect).matrix);
    gl.uniform1f(this.at.u_cut, this.cuts ? this.floorZ + CUT : 1e9);
    gl.disable(gl.BLEND); gl.depthMask(true);
    let blending = false;
    for (const batch of m.batches) {
      if (batch.link >= 0 && (!this.poses || this.poses.length < (batch.link + 1) * 7)) continue;
      if (numbers && batch.blend) continue; // one points through glass
      if (batch.blend !== blending) { blending = batch.blend; blending ? gl.enable(gl.BLEND) : gl.disable(gl.BLEND); gl.depthMask(!blending); gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA); }
      const chosen = batch.link >= 0 && this.selected && this.names[batch.link] === this.selected, matrix = batch.link < 0 ? IDENTITY : fromPose(this.poses, batch.link), n = batch.link + 2;
      if (chosen && this.drag) { matrix[12] += this.drag.by[0]; matrix[13] += this.drag.by[1]; }
      gl.uniformMatrix4fv(this.at.u_link, false, matrix);
      gl.uniform4f(this.at.u_tint, 0.1, 0.55, 1, chosen ? 0.45 : 0);
      numbers ? gl.uniform4f(this.at.u_number, (n & 255) / 255, ((n >> 8) & 255) / 255, (n >> 16) / 255, 1) : gl.uniform4f(this.at.u_number, 0, 0, 0, 0);
      gl.uniform1i(this.at.u_unlit, batch.unlit); gl.uniform1i(this.at.u_textured, batch.texture >= 0);
      if (batch.texture >= 0) gl.bindTexture(gl.TEXTURE_2D, m.textures[batch.texture]);
      gl.drawElements(gl.TRIANGLES, batch.count, gl.UNSIGNED_INT, batch.first * 4);
    }
    gl.depthMask(true); gl.bindVertexArray(null);
  }

  // Returns the name of the body at a pixel of the canvas; '' = none.
  pick(px, py) {
    const gl = this.gl, w = this.canvas.width, h = this.canvas.height, ratio = w / this.canvas.clientWidth, x = Math.floor(px * ratio), y = h - 1 - Math.floor(py * ratio);
    if (!this.model || !w) return '';
    const frame = gl.createFramebuffer(), color = gl.createRenderbuffer(), depth = gl.createRenderbuffer(), pixel = new Uint8Array(4);
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    for (const [buffer, format, place] of [[color, gl.RGBA8, gl.COLOR_ATTACHMENT0], [depth, gl.DEPTH_COMPONENT16, gl.DEPTH_ATTACHMENT]]) {
      gl.bindRenderbuffer(gl.RENDERBUFFER, buffer); gl.renderbufferStorage(gl.RENDERBUFFER, format, w, h); gl.framebufferRenderbuffer(gl.FRAMEBUFFER, place, gl.RENDERBUFFER, buffer);
    }
    gl.viewport(0, 0, w, h); gl.enable(gl.SCISSOR_TEST); gl.scissor(x, y, 1, 1);
    gl.clearColor(0, 0, 0, 0); gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    this.drawBatches(w / h, true);
    gl.readPixels(x, y, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
    gl.disable(gl.SCISSOR_TEST); gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.deleteFramebuffer(frame); gl.deleteRenderbuffer(color); gl.deleteRenderbuffer(depth);
    const link = pixel[0] + 256 * pixel[1] + 65536 * pixel[2] - 2;
    return link >= 0 ? this.names[link] ?? '' : '';
  }
}
