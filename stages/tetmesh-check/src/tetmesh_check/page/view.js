// The 3-D view: WebGL 2, no library. The script element #view-data holds the meshes: JSON and arrays, deflated, in base64.
"use strict";
(async () => {
  const canvas = document.getElementById("view");
  const pick = id => document.getElementById(id);
  const fail = why => { canvas.dataset.state = "failed"; pick("view-note").textContent = why; };
  const gl = canvas.getContext("webgl2", { antialias: true, alpha: true, premultipliedAlpha: false });
  if (!gl) return fail("This browser has no WebGL 2, so the 3-D view is not shown; the pictures below are.");
  if (!("DecompressionStream" in window)) return fail("This browser is too old for the 3-D view; the pictures below show the mesh.");

  // --- meshes: every triangle gets corners of its own, so that each has its own edges and colour
  const packed = Uint8Array.from(atob(pick("view-data").textContent), c => c.charCodeAt(0));
  const plain = await new Response(new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"))).arrayBuffer();
  const about = JSON.parse(pick("view-about").textContent);
  const unsplit = (start, count) => {  // four planes of bytes of zigzag differences
    const bytes = new Uint8Array(plain, start, 4 * count), out = new Int32Array(count);
    for (let i = 0, last = 0; i < count; i++) {
      const z = bytes[i] | bytes[count + i] << 8 | bytes[2 * count + i] << 16 | bytes[3 * count + i] << 24;
      out[i] = last += (z >>> 1) ^ -(z & 1);
    }
    return out;
  };
  const load = mesh => {
    const p = unsplit(mesh.points, 3 * mesh.point_count), t = unsplit(mesh.triangles, 3 * mesh.triangle_count);
    const quality = new Uint8Array(plain, mesh.quality, mesh.triangle_count), size = new Uint8Array(plain, mesh.size, mesh.point_count);
    const position = new Float32Array(3 * t.length), value = new Uint8Array(2 * t.length);
    for (let i = 0; i < t.length; i++) {
      for (let k = 0; k < 3; k++) position[3 * i + k] = p[k * mesh.point_count + t[i]] * about.step;
      value[2 * i] = quality[(i / 3) | 0]; value[2 * i + 1] = size[t[i]];
    }
    const array = gl.createVertexArray(); gl.bindVertexArray(array);
    [[position, 3, gl.FLOAT, false], [value, 2, gl.UNSIGNED_BYTE, true]].forEach(([data, n, type, norm], at) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer()); gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(at); gl.vertexAttribPointer(at, n, type, norm, 0, 0);
    });
    return { array, count: t.length };
  };

  const source = [[gl.VERTEX_SHADER, `#version 300 es
    layout(location = 0) in vec3 position; layout(location = 1) in vec2 value;
    uniform mat3 turn; uniform vec4 place;  // shift x, y; scale x, y
    out vec3 eye; out vec3 corner; out vec2 v;
    void main() {
      eye = turn * position; v = value; int k = gl_VertexID % 3;
      corner = vec3(k == 0, k == 1, k == 2);
      gl_Position = vec4((eye.xy + place.xy) * place.zw, -0.5 * eye.z, 1.0);
    }`], [gl.FRAGMENT_SHADER, `#version 300 es
    precision highp float;
    in vec3 eye; in vec3 corner; in vec2 v; uniform int colour; uniform bool edges; out vec4 result;
    vec3 viridis(float t) {  // polynomial fit by Matt Zucker, CC0
      return vec3(0.27773, 0.00541, 0.33410) + t * (vec3(0.10509, 1.40461, 1.38459) + t * (vec3(-0.33086, 0.21485, 0.09510)
        + t * (vec3(-4.63423, -5.79910, -19.33244) + t * (vec3(6.22827, 14.17993, 56.69055)
        + t * (vec3(4.77638, -13.74515, -65.35303) + t * vec3(-5.43546, 4.64585, 26.31244))))));
    }
    void main() {
      vec3 n = normalize(cross(dFdx(eye), dFdy(eye)));
      float light = 0.30 + 0.55 * abs(dot(n, normalize(vec3(0.35, 0.45, 0.82)))) + 0.15 * abs(n.z);
      vec3 base = colour == 0 ? vec3(0.95, 0.86, 0.76) : viridis(colour == 1 ? v.x : v.y);
      vec3 width = fwidth(corner), near = smoothstep(vec3(0.0), 1.2 * width, corner);
      float line = (1.0 - min(near.x, min(near.y, near.z))) * (1.0 - smoothstep(0.20, 0.80, max(width.x, max(width.y, width.z))));
      result = vec4(mix(base * light, vec3(0.10, 0.11, 0.13), edges ? 0.58 * line : 0.0), 1.0);
    }`]];
  const program = gl.createProgram();
  for (const [kind, text] of source) {
    const shader = gl.createShader(kind); gl.shaderSource(shader, text); gl.compileShader(shader); gl.attachShader(program, shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) return fail(`The 3-D view cannot be drawn: ${gl.getShaderInfoLog(shader)}`);
  }
  gl.linkProgram(program); gl.useProgram(program); gl.enable(gl.DEPTH_TEST);
  const uniform = name => gl.getUniformLocation(program, name);
  const at = { turn: uniform("turn"), place: uniform("place"), colour: uniform("colour"), edges: uniform("edges") };
  const meshes = Object.fromEntries(about.meshes.map(mesh => [mesh.name, load(mesh)]));

  // --- camera: orthographic; yaw about the body's long axis z, pitch towards the eye
  const start = () => ({ yaw: about.yaw, pitch: about.pitch, zoom: 1, x: 0, y: 0 });
  let camera = start(), waiting = false;
  const draw = () => {
    waiting = false;
    const ratio = window.devicePixelRatio || 1, w = Math.round(canvas.clientWidth * ratio), h = Math.round(canvas.clientHeight * ratio);
    if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
    gl.viewport(0, 0, w, h); gl.clearColor(0, 0, 0, 0); gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const [cy, sy, cp, sp] = [Math.cos(camera.yaw), Math.sin(camera.yaw), Math.cos(camera.pitch), Math.sin(camera.pitch)];
    gl.uniformMatrix3fv(at.turn, false, [cy, -sp * sy, cp * sy, sy, sp * cy, -cp * cy, 0, cp, sp]);
    const scale = camera.zoom / Math.max(about.reach[1], about.reach[0] * h / w), mesh = meshes[pick("view-mesh").value];
    gl.uniform4f(at.place, camera.x, camera.y, scale * h / w, scale);
    gl.uniform1i(at.colour, +pick("view-colour").value); gl.uniform1i(at.edges, pick("view-edges").checked ? 1 : 0);
    gl.bindVertexArray(mesh.array); gl.drawArrays(gl.TRIANGLES, 0, mesh.count);
    if (!canvas.dataset.state) {  // once: how much of the picture is covered
      const pixels = new Uint8Array(4 * w * h); gl.readPixels(0, 0, w, h, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
      let covered = 0; for (let i = 3; i < pixels.length; i += 4) covered += pixels[i] > 0;
      canvas.dataset.covered = (covered / (w * h)).toFixed(4);
      canvas.dataset.state = gl.getError() || !covered ? "failed" : "drawn";
    }
  };
  const redraw = () => { if (!waiting) { waiting = true; requestAnimationFrame(draw); } };
  const clamp = () => { camera.pitch = Math.max(-1.57, Math.min(1.57, camera.pitch)); camera.zoom = Math.max(0.3, Math.min(80, camera.zoom)); };
  const unit = () => 2 * Math.max(about.reach[1], about.reach[0] * canvas.height / canvas.width) / camera.zoom / canvas.clientHeight;
  const fingers = new Map();
  canvas.addEventListener("pointerdown", e => { canvas.setPointerCapture(e.pointerId); fingers.set(e.pointerId, e); canvas.focus({ preventScroll: true }); });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, e => fingers.delete(e.pointerId));
  canvas.addEventListener("pointermove", e => {
    const before = fingers.get(e.pointerId); if (!before) return;
    const dx = e.clientX - before.clientX, dy = e.clientY - before.clientY;
    if (fingers.size === 2) {
      const other = [...fingers.entries()].find(([id]) => id !== e.pointerId)[1], far = a => Math.hypot(a.clientX - other.clientX, a.clientY - other.clientY);
      camera.zoom *= far(e) / Math.max(1, far(before)); camera.x += 0.5 * dx * unit(); camera.y -= 0.5 * dy * unit();
    } else if (e.shiftKey || e.buttons & 6) { camera.x += dx * unit(); camera.y -= dy * unit(); }
    else { camera.yaw -= 0.008 * dx; camera.pitch += 0.008 * dy; }
    fingers.set(e.pointerId, e); clamp(); redraw();
  });
  canvas.addEventListener("wheel", e => { e.preventDefault(); camera.zoom *= Math.exp(-0.0012 * e.deltaY); clamp(); redraw(); }, { passive: false });
  canvas.addEventListener("contextmenu", e => e.preventDefault());
  canvas.addEventListener("dblclick", () => { camera = start(); redraw(); });
  const keys = { ArrowLeft: c => c.yaw += 0.1, ArrowRight: c => c.yaw -= 0.1, ArrowUp: c => c.pitch += 0.1, ArrowDown: c => c.pitch -= 0.1,
    "+": c => c.zoom *= 1.2, "-": c => c.zoom /= 1.2, 0: () => { camera = start(); } };
  canvas.addEventListener("keydown", e => { if (keys[e.key]) { e.preventDefault(); keys[e.key](camera); clamp(); redraw(); } });
  for (const id of ["view-mesh", "view-colour", "view-edges"]) pick(id).addEventListener("change", () => {
    pick("view-scale").textContent = about.scales[pick("view-colour").value]; pick("view-bar").hidden = pick("view-colour").value === "0"; redraw(); });
  new ResizeObserver(redraw).observe(canvas);
  draw();
})().catch(error => {
  document.getElementById("view").dataset.state = "failed";
  document.getElementById("view-note").textContent = `The 3-D view cannot be drawn: ${error.message}`;
  throw error;
});
