"use strict";
// Gaussian splats in WebGL 2: every splat is a square that its 2D covariance shapes, drawn far to near.
// Object frame: z up; azimuth 0 looks from +x, 90 from +y; elevation looks down.

function unpackSplats(splats, packing) {
  const raw = Uint8Array.from(atob(splats.data), (c) => c.charCodeAt(0));
  const n = splats.count, view = new DataView(raw.buffer);
  const ratio = Math.log(packing.largest / packing.smallest);
  const texels = new Float32Array(16 * n), means = new Float32Array(3 * n);
  for (let i = 0; i < n; i++) {
    const s = [], q = [], m = [];
    for (let a = 0; a < 3; a++) {
      m.push((view.getUint16(2 * (3 * i + a), true) / 65535 * 2 - 1) * packing.reach);
      s.push(packing.smallest * Math.exp(raw[6 * n + 3 * i + a] / 255 * ratio));
      means[3 * i + a] = m[a];
    }
    for (let a = 0; a < 4; a++) q.push(view.getInt8(9 * n + 4 * i + a) / 127);
    const length = Math.hypot(...q) || 1, [w, x, y, z] = q.map((v) => v / length);
    const r = [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
      2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
      2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)];
    const c = (a, b) => r[3 * a] * r[3 * b] * s[0] * s[0] + r[3 * a + 1] * r[3 * b + 1] * s[1] * s[1]
      + r[3 * a + 2] * r[3 * b + 2] * s[2] * s[2];
    const k = 13 * n + 4 * i;
    texels.set([...m, 0, c(0, 0), c(0, 1), c(0, 2), c(1, 1), c(1, 2), c(2, 2), 0, 0,
      raw[k] / 255, raw[k + 1] / 255, raw[k + 2] / 255, raw[k + 3] / 255], 16 * i);
  }
  return { n, texels, means };
}

function joined(parts) { // one after the other; flags say which
  const n = parts.reduce((sum, part) => sum + part.n, 0);
  const scene = { n, texels: new Float32Array(16 * n), means: new Float32Array(3 * n), flags: new Uint8Array(n) };
  let at = 0;
  parts.forEach((part, flag) => {
    scene.texels.set(part.texels, 16 * at); scene.means.set(part.means, 3 * at);
    for (let i = at; i < at + part.n; i++) scene.flags[i] = scene.texels[16 * i + 3] = flag;
    at += part.n;
  });
  return scene;
}

const VERTEX = `#version 300 es
precision highp float; precision highp sampler2D; precision highp int;
uniform sampler2D data; uniform mat4 view; uniform vec2 focal; uniform vec2 size; uniform float tint;
in vec2 corner; in uint row; out vec4 color; out vec2 at;
vec4 texel(int k) { int i = 4 * int(row) + k; return texelFetch(data, ivec2(i % 4096, i / 4096), 0); }
void main() {
  vec4 place = texel(0), a = texel(1), b = texel(2), rgba = texel(3);
  vec3 p = (view * vec4(place.xyz, 1.0)).xyz;
  if (p.z < 0.05) { gl_Position = vec4(2.0, 2.0, 2.0, 1.0); return; }
  mat3 sigma = mat3(a.x, a.y, a.z, a.y, a.w, b.x, a.z, b.x, b.y);
  mat3 jacobian = mat3(focal.x / p.z, 0.0, 0.0, 0.0, focal.y / p.z, 0.0,
    -focal.x * p.x / (p.z * p.z), -focal.y * p.y / (p.z * p.z), 0.0);
  mat3 t = jacobian * mat3(view);
  mat3 flat_ = t * sigma * transpose(t);
  float xx = flat_[0][0] + 0.3, yy = flat_[1][1] + 0.3, xy = flat_[0][1];
  float middle = 0.5 * (xx + yy), root = length(vec2(0.5 * (xx - yy), xy));
  float l1 = middle + root, l2 = max(middle - root, 0.1);
  vec2 axis = abs(xy) < 1e-6 ? (xx >= yy ? vec2(1.0, 0.0) : vec2(0.0, 1.0)) : normalize(vec2(xy, l1 - xx));
  vec2 offset = 3.0 * (corner.x * sqrt(l1) * axis + corner.y * sqrt(l2) * vec2(-axis.y, axis.x));
  vec2 pixel = focal * p.xy / p.z + offset;
  gl_Position = vec4(2.0 * pixel.x / size.x, -2.0 * pixel.y / size.y, 0.0, 1.0);
  float light = dot(rgba.rgb, vec3(0.33));
  vec3 hue = place.w > 0.5 ? vec3(0.98, 0.55, 0.15) : vec3(0.25, 0.5, 0.95);
  color = vec4(mix(rgba.rgb, 0.4 * vec3(light) + 0.6 * hue * (0.35 + 0.65 * light), tint), rgba.a);
  at = 3.0 * corner;
}`;
const FRAGMENT = `#version 300 es
precision highp float; in vec4 color; in vec2 at; out vec4 result;
void main() {
  float alpha = color.a * exp(-0.5 * dot(at, at));
  if (alpha < 0.004) discard;
  result = vec4(color.rgb * alpha, alpha);
}`;

class SplatView {
  constructor() {
    this.canvas = document.createElement("canvas");
    this.gl = this.canvas.getContext("webgl2", { alpha: false, antialias: false, preserveDrawingBuffer: true });
    if (!this.gl) throw new Error("WebGL 2 is not available in this browser");
    const gl = this.gl, program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text); gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(program, shader);
    }
    gl.bindAttribLocation(program, 0, "corner"); gl.bindAttribLocation(program, 1, "row");
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    gl.useProgram(program);
    this.at = (name) => gl.getUniformLocation(program, name);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]), gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0); gl.vertexAttribPointer(0, 2, gl.FLOAT, false, 0, 0);
    this.rows = gl.createBuffer(); gl.bindBuffer(gl.ARRAY_BUFFER, this.rows);
    gl.enableVertexAttribArray(1); gl.vertexAttribIPointer(1, 1, gl.UNSIGNED_INT, 0, 0); gl.vertexAttribDivisor(1, 1);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
    gl.enable(gl.BLEND); gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    this.show = "all"; this.tint = 0; this.spin = false; this.waiting = false;
    this.listen();
  }

  load(parts, packing, azimuth, elevation) { // the input's splats, then those added
    const gl = this.gl, scene = joined(parts.map((splats) => unpackSplats(splats, packing)));
    const lines = Math.max(1, Math.ceil(4 * scene.n / 4096)), padded = new Float32Array(4 * 4096 * lines);
    padded.set(scene.texels);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, 4096, lines, 0, gl.RGBA, gl.FLOAT, padded);
    this.scene = scene; this.azimuth = azimuth; this.elevation = elevation; this.radius = 2.2;
    this.draw();
  }

  listen() {
    const canvas = this.canvas; let last = null;
    canvas.addEventListener("pointerdown", (e) => { last = [e.clientX, e.clientY]; canvas.setPointerCapture(e.pointerId); this.spin = false; });
    canvas.addEventListener("pointerup", () => { last = null; });
    canvas.addEventListener("pointermove", (e) => {
      if (!last) return;
      this.azimuth -= 0.5 * (e.clientX - last[0]);
      this.elevation = Math.max(-89, Math.min(89, this.elevation + 0.5 * (e.clientY - last[1])));
      last = [e.clientX, e.clientY]; this.draw();
    });
    canvas.addEventListener("wheel", (e) => {
      e.preventDefault(); this.radius = Math.max(0.6, Math.min(8, this.radius * Math.exp(0.001 * e.deltaY))); this.draw();
    }, { passive: false });
  }

  draw() {
    if (this.waiting || !this.scene) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false; this.paint();
      if (this.spin && this.canvas.isConnected) { this.azimuth += 0.6; this.draw(); }
    });
  }

  order(forward, position) { // far to near by counting sort of depths
    const { n, means, flags } = this.scene, cells = 4096, depth = new Float32Array(n);
    let low = Infinity, high = -Infinity;
    for (let i = 0; i < n; i++) {
      depth[i] = forward[0] * (means[3 * i] - position[0]) + forward[1] * (means[3 * i + 1] - position[1]) + forward[2] * (means[3 * i + 2] - position[2]);
      if (depth[i] < low) low = depth[i]; if (depth[i] > high) high = depth[i];
    }
    const counts = new Uint32Array(cells + 1), cell = new Uint16Array(n), factor = (cells - 1) / Math.max(high - low, 1e-9);
    const shown = (i) => this.show === "all" || (this.show === "input") === (flags[i] === 0);
    let total = 0;
    for (let i = 0; i < n; i++) if (shown(i)) { cell[i] = (high - depth[i]) * factor; counts[cell[i] + 1]++; total++; }
    for (let k = 0; k < cells; k++) counts[k + 1] += counts[k];
    const rows = new Uint32Array(total);
    for (let i = 0; i < n; i++) if (shown(i)) rows[counts[cell[i]]++] = i;
    return rows;
  }

  paint() {
    const gl = this.gl, canvas = this.canvas, ratio = Math.min(2, window.devicePixelRatio || 1);
    const width = Math.max(1, Math.round(canvas.clientWidth * ratio)), height = Math.max(1, Math.round(canvas.clientHeight * ratio));
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    const a = this.azimuth * Math.PI / 180, e = this.elevation * Math.PI / 180;
    const out = [Math.cos(e) * Math.cos(a), Math.cos(e) * Math.sin(a), Math.sin(e)];
    const right = [-Math.sin(a), Math.cos(a), 0], down = [Math.sin(e) * Math.cos(a), Math.sin(e) * Math.sin(a), -Math.cos(e)];
    const position = out.map((v) => v * this.radius), forward = out.map((v) => -v);
    const dot = (u) => -(u[0] * position[0] + u[1] * position[1] + u[2] * position[2]);
    const view = [right[0], down[0], forward[0], 0, right[1], down[1], forward[1], 0, right[2], down[2], forward[2], 0, dot(right), dot(down), dot(forward), 1];
    const focal = 0.5 * Math.min(width, height) / Math.tan(20 * Math.PI / 180);
    gl.viewport(0, 0, width, height); gl.clearColor(0.78, 0.78, 0.78, 1); gl.clear(gl.COLOR_BUFFER_BIT);
    gl.uniformMatrix4fv(this.at("view"), false, view); gl.uniform2f(this.at("focal"), focal, focal);
    gl.uniform2f(this.at("size"), width, height); gl.uniform1f(this.at("tint"), this.tint);
    const rows = this.order(forward, position);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.rows); gl.bufferData(gl.ARRAY_BUFFER, rows, gl.STREAM_DRAW);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, rows.length);
  }
}
