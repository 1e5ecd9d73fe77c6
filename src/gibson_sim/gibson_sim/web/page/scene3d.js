// The scene in 3-D, rendered with WebGL 2: orbit, pan and zoom with the pointer, or follow a robot. World frame, metres, z up.

const VERTEX = `#version 300 es
uniform mat4 u_camera, u_link;
layout(location = 0) in vec3 a_position; layout(location = 1) in vec2 a_uv; layout(location = 2) in vec4 a_normal; layout(location = 3) in vec4 a_color;
out vec2 v_uv; out vec4 v_color; out vec3 v_normal;
void main() { gl_Position = u_camera * u_link * vec4(a_position, 1.0); v_uv = a_uv; v_color = a_color; v_normal = mat3(u_link) * a_normal.xyz; }`;
const FRAGMENT = `#version 300 es
precision mediump float;
uniform sampler2D u_texture; uniform bool u_textured, u_unlit;
in vec2 v_uv; in vec4 v_color; in vec3 v_normal; out vec4 color;
void main() {
  color = v_color; if (u_textured) color *= texture(u_texture, v_uv);
  if (color.a < 0.05) discard;
  if (!u_unlit) color.rgb *= 0.62 + 0.38 * max(0.0, dot(normalize(v_normal), normalize(vec3(-0.35, -0.25, 0.9))));
}`;
const BYTES = 28; // per vertex

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
const IDENTITY = new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);

export class Scene3D {
  constructor(canvas, onReady) {
    this.canvas = canvas; this.onReady = onReady; this.model = null; this.poses = null; this.follow = true;
    this.target = [0, 0, 0.5]; this.distance = 4; this.azimuth = Math.PI; this.elevation = 0.7; this.pending = false; this.pointers = new Map();
    this.gl = canvas.getContext('webgl2', { antialias: true });
    if (!this.gl) return;
    this.program = this.build();
    canvas.oncontextmenu = (event) => event.preventDefault();
    canvas.onpointerdown = (event) => { canvas.setPointerCapture(event.pointerId); this.pointers.set(event.pointerId, [event.offsetX, event.offsetY]); };
    canvas.onpointerup = canvas.onpointercancel = (event) => this.pointers.delete(event.pointerId);
    canvas.onpointermove = (event) => this.dragged(event);
    canvas.onwheel = (event) => { event.preventDefault(); this.zoom(Math.exp(event.deltaY * 0.0012)); };
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  build() {
    const gl = this.gl, program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text); gl.compileShader(shader); gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    this.at = Object.fromEntries(['u_camera', 'u_link', 'u_texture', 'u_textured', 'u_unlit'].map((n) => [n, gl.getUniformLocation(program, n)]));
    return program;
  }

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
    this.onReady?.();
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

  setPoses(buffer) { this.poses = new Float32Array(buffer.slice(12)); this.draw(); }

  setRobot(robot) { if (this.follow && robot) { this.target[0] = robot.x; this.target[1] = robot.y; } this.draw(); }

  zoom(factor) { this.distance = Math.max(0.4, Math.min(80, this.distance * factor)); this.draw(); }

  dragged(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const dx = event.offsetX - before[0], dy = event.offsetY - before[1];
    if (this.pointers.size === 2) {
      const other = [...this.pointers.entries()].find(([id]) => id !== event.pointerId)[1];
      const was = Math.hypot(before[0] - other[0], before[1] - other[1]), is = Math.hypot(event.offsetX - other[0], event.offsetY - other[1]);
      if (is > 5) this.zoom(was / is);
    } else if (event.buttons & 2 || event.shiftKey) {
      const scale = this.distance / this.canvas.clientHeight, c = Math.cos(this.azimuth), s = Math.sin(this.azimuth);
      this.follow = false;
      this.target[0] += (dx * s + dy * c) * -scale * -1; this.target[1] += (-dx * c + dy * s) * -scale * -1;
    } else {
      this.azimuth -= dx * 0.008; this.elevation = Math.max(-0.2, Math.min(1.55, this.elevation + dy * 0.008));
    }
    this.pointers.set(event.pointerId, [event.offsetX, event.offsetY]);
    this.draw();
  }

  draw() { if (!this.pending && this.gl) { this.pending = true; requestAnimationFrame(() => { this.pending = false; this.paint(); }); } }

  paint() {
    const gl = this.gl, canvas = this.canvas, ratio = devicePixelRatio || 1, w = Math.round(canvas.clientWidth * ratio), h = Math.round(canvas.clientHeight * ratio);
    if (!w || !h || !this.model) return;
    if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
    const m = this.model, [r, g, b] = m.background, ce = Math.cos(this.elevation);
    const eye = [this.target[0] + this.distance * ce * Math.cos(this.azimuth), this.target[1] + this.distance * ce * Math.sin(this.azimuth), this.target[2] + this.distance * Math.sin(this.elevation)];
    const camera = multiply(perspective(0.9, w / h, 0.05, 300), lookAt(eye, this.target));
    gl.viewport(0, 0, w, h); gl.clearColor(r, g, b, 1); gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST); gl.enable(gl.CULL_FACE); gl.cullFace(gl.BACK); // back-face culling makes walls between the camera and the room invisible
    gl.useProgram(this.program); gl.bindVertexArray(m.array);
    gl.uniformMatrix4fv(this.at.u_camera, false, camera);
    let blending = null;
    for (const batch of m.batches) {
      if (batch.link >= 0 && (!this.poses || this.poses.length < (batch.link + 1) * 7)) continue;
      if (batch.blend !== blending) { blending = batch.blend; blending ? gl.enable(gl.BLEND) : gl.disable(gl.BLEND); gl.depthMask(!blending); gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA); }
      gl.uniformMatrix4fv(this.at.u_link, false, batch.link < 0 ? IDENTITY : fromPose(this.poses, batch.link));
      gl.uniform1i(this.at.u_unlit, batch.unlit); gl.uniform1i(this.at.u_textured, batch.texture >= 0);
      if (batch.texture >= 0) gl.bindTexture(gl.TEXTURE_2D, m.textures[batch.texture]);
      gl.drawElements(gl.TRIANGLES, batch.count, gl.UNSIGNED_INT, batch.first * 4);
    }
    gl.depthMask(true); gl.bindVertexArray(null);
    canvas.dataset.drawn = Number(canvas.dataset.drawn || 0) + 1;
  }
}
