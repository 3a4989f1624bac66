// The 3-D view: WebGL 2, no library. The script element #view-data holds the meshes: JSON and arrays, deflated, in base64.
"use strict";
(async () => {
  const canvas = document.getElementById("view");
  if (!canvas) return;
  const pick = id => document.getElementById(id);
  const fail = why => {
    canvas.dataset.state = "failed"; pick("view-note").textContent = why; pick("view-value").hidden = true;
    for (const id of ["view-cube", "view-ruler"]) pick(id).style.display = "none";
  };
  const gl = canvas.getContext("webgl2", { antialias: true, alpha: true, premultipliedAlpha: true });
  if (!gl) return fail("This browser has no WebGL 2, so the 3-D view is not shown; the pictures below are.");
  if (!("DecompressionStream" in window)) return fail("This browser is too old for the 3-D view; the pictures below show the mesh.");
  window.addEventListener("error", event => { canvas.dataset.state = "failed"; canvas.dataset.error = event.message; });

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
  const valuesOf = (mesh, colour) => {  // two planes of bytes
    const count = colour.on_triangles ? mesh.triangle_count : mesh.point_count, bytes = new Uint8Array(plain, colour.start, 2 * count);
    return Float32Array.from({ length: count }, (_, i) => colour.least + (bytes[i] | bytes[count + i] << 8) / 65535 * (colour.largest - colour.least));
  };
  const attribute = (at, data, size) => {
    const buffer = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer); gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(at); gl.vertexAttribPointer(at, size, gl.FLOAT, false, 0, 0);
    return buffer;
  };
  const meshes = about.meshes.map(mesh => {
    const p = unsplit(mesh.points, 3 * mesh.point_count), t = unsplit(mesh.triangles, 3 * mesh.triangle_count);
    const position = new Float32Array(3 * t.length);
    for (let i = 0; i < t.length; i++) for (let k = 0; k < 3; k++) position[3 * i + k] = p[k * mesh.point_count + t[i]] * about.step;
    const array = gl.createVertexArray(); gl.bindVertexArray(array);
    attribute(0, position, 3);
    const shown = attribute(1, new Float32Array(2 * t.length), 2);
    return { ...mesh, t, position, array, shown, count: t.length, colours: mesh.colours.map(colour => ({ ...colour, values: valuesOf(mesh, colour) })) };
  });

  const source = [[gl.VERTEX_SHADER, `#version 300 es
    layout(location = 0) in vec3 position; layout(location = 1) in vec2 value;  // place on the colour bar; 1 among the worst
    uniform mat3 turn; uniform vec4 place;  // shift x, y; scale x, y
    out vec3 eye; out vec3 body; out vec3 corner; out vec2 v; flat out int triangle;
    void main() {
      body = position; eye = turn * position; v = value; int k = gl_VertexID % 3; triangle = gl_VertexID / 3;
      corner = vec3(k == 0, k == 1, k == 2);
      gl_Position = vec4((eye.xy + place.xy) * place.zw, -0.5 * eye.z, 1.0);
    }`], [gl.FRAGMENT_SHADER, `#version 300 es
    precision highp float; precision highp int;
    in vec3 eye; in vec3 body; in vec3 corner; in vec2 v; flat in int triangle;
    uniform bool coloured; uniform bool edges; uniform bool worst; uniform bool ghost; uniform bool picking; uniform vec4 clip; out vec4 result;
    uniform bool named; uniform sampler2D palette;
    vec3 viridis(float t) {  // polynomial fit by Matt Zucker, CC0
      return vec3(0.27773, 0.00541, 0.33410) + t * (vec3(0.10509, 1.40461, 1.38459) + t * (vec3(-0.33086, 0.21485, 0.09510)
        + t * (vec3(-4.63423, -5.79910, -19.33244) + t * (vec3(6.22827, 14.17993, 56.69055)
        + t * (vec3(4.77638, -13.74515, -65.35303) + t * vec3(-5.43546, 4.64585, 26.31244))))));
    }
    void main() {
      if (dot(clip.xyz, body) > clip.w) discard;
      if (picking) { int n = triangle + 1; result = vec4(n & 255, (n >> 8) & 255, (n >> 16) & 255, 255) / 255.0; return; }
      vec3 n = normalize(cross(dFdx(eye), dFdy(eye)));
      float light = 0.30 + 0.55 * abs(dot(n, normalize(vec3(0.35, 0.45, 0.82)))) + 0.15 * abs(n.z);
      if (ghost) { result = vec4(vec3(0.55, 0.60, 0.66) * 0.16, 0.16) * (1.2 - abs(n.z)); return; }
      vec3 base = named ? texelFetch(palette, ivec2(int(v.x + 0.5), 0), 0).rgb : coloured ? viridis(clamp(v.x, 0.0, 1.0)) : vec3(0.95, 0.86, 0.76);
      if (worst) base = v.y > 0.5 ? vec3(0.93, 0.11, 0.36) : mix(vec3(dot(base, vec3(0.3, 0.6, 0.1))), vec3(0.62), 0.7);
      else if (!gl_FrontFacing) base = vec3(0.62, 0.38, 0.33);  // what a clipped surface shows of its inside
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
  const palette = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, palette); gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
  const at = Object.fromEntries(["turn", "place", "coloured", "edges", "worst", "ghost", "picking", "clip", "named"].map(name => [name, gl.getUniformLocation(program, name)]));

  // --- camera: orthographic; yaw about the body's long axis z, pitch towards the eye
  const start = () => ({ yaw: about.yaw, pitch: about.pitch, zoom: 1, x: 0, y: 0 });
  let camera = start(), waiting = false, picked = null;
  const mesh = () => meshes[+pick("view-mesh").value];
  const colour = () => mesh().colours[pick("view-colour").value];  // "" is plain
  const named = () => colour()?.names.length > 0;
  const turn = () => {  // columns
    const [cy, sy, cp, sp] = [Math.cos(camera.yaw), Math.sin(camera.yaw), Math.cos(camera.pitch), Math.sin(camera.pitch)];
    return [cy, -sp * sy, cp * sy, sy, sp * cy, -cp * cy, 0, cp, sp];
  };
  const scale = () => camera.zoom / Math.max(about.reach[1], about.reach[0] * canvas.clientHeight / canvas.clientWidth);  // of half the height
  const clipping = () => {
    const mode = pick("view-clip").value, depth = +pick("view-depth").value / 100, m = turn();
    if (mode === "") return [0, 0, 0, 1];
    if (mode === "view") return [m[2], m[5], m[8], -1.2 * depth];
    return [0, 1, 2].map(axis => axis === +mode ? 1 : 0).concat(depth);
  };
  const paint = (picking, w, h) => {
    gl.bindTexture(gl.TEXTURE_2D, palette);
    gl.viewport(0, 0, w, h); gl.clearColor(0, 0, 0, 0); gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniformMatrix3fv(at.turn, false, turn());
    gl.uniform4f(at.place, camera.x, camera.y, scale() * canvas.clientHeight / canvas.clientWidth, scale());
    gl.uniform4fv(at.clip, clipping());
    gl.uniform1i(at.coloured, colour() ? 1 : 0); gl.uniform1i(at.named, named() ? 1 : 0); gl.uniform1i(at.edges, pick("view-edges").checked ? 1 : 0);
    gl.uniform1i(at.worst, pick("view-worst").checked && !mesh().within ? 1 : 0);
    gl.uniform1i(at.picking, picking ? 1 : 0); gl.uniform1i(at.ghost, 0);
    gl.bindVertexArray(mesh().array); gl.drawArrays(gl.TRIANGLES, 0, mesh().count);
    if (mesh().within && !picking && !meshes[0].within) {
      gl.uniform1i(at.ghost, 1); gl.enable(gl.BLEND); gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA); gl.depthMask(false);
      gl.bindVertexArray(meshes[0].array); gl.drawArrays(gl.TRIANGLES, 0, meshes[0].count);
      gl.depthMask(true); gl.disable(gl.BLEND);
    }
  };
  const draw = () => {
    waiting = false; picked = null;
    const ratio = window.devicePixelRatio || 1, w = Math.round(canvas.clientWidth * ratio), h = Math.round(canvas.clientHeight * ratio);
    if (!w || !h) return;
    if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
    paint(false, w, h); cube(); ruler();
    canvas.dataset.camera = [camera.yaw, camera.pitch, camera.zoom, camera.x, camera.y].map(v => v.toFixed(4)).join(" ");
    if (!canvas.dataset.state || canvas.dataset.measure) {  // how much of the picture is covered
      const pixels = new Uint8Array(4 * w * h); gl.readPixels(0, 0, w, h, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
      let covered = 0; for (let i = 3; i < pixels.length; i += 4) covered += pixels[i] > 0;
      canvas.dataset.covered = (covered / (w * h)).toFixed(4);
      if (!canvas.dataset.state) canvas.dataset.state = gl.getError() || !covered ? "failed" : "drawn";
    }
  };
  const redraw = () => { if (!waiting) { waiting = true; requestAnimationFrame(draw); } };

  // --- what is shown, and the colour bar beside it
  const say = (value, c) => c.names.length ? c.names[Math.round(value)] : `${+value.toPrecision(3)}${c.unit}`;
  const recolour = () => {
    const m = mesh(), c = colour(), judge = c && c.worst ? c : m.colours[0], shown = new Float32Array(2 * m.count);
    const at = (k, i) => k.values[k.on_triangles ? (i / 3) | 0 : m.t[i]];
    for (let i = 0; i < m.count; i++) {
      shown[2 * i] = !c ? 0 : named() ? at(c, i) : (at(c, i) - c.low) / (c.high - c.low);
      shown[2 * i + 1] = judge.worst === "high" ? at(judge, i) >= judge.threshold : at(judge, i) <= judge.threshold;
    }
    gl.bindBuffer(gl.ARRAY_BUFFER, m.shown); gl.bufferData(gl.ARRAY_BUFFER, shown, gl.STATIC_DRAW);
    if (named()) {  // one pixel a name; rows are not padded to four bytes
      gl.bindTexture(gl.TEXTURE_2D, palette); gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, c.names.length, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, Uint8Array.from(c.palette));
    }
    const worst = pick("view-worst").checked && !m.within, bar = pick("view-bar"), words = bar.querySelectorAll("span");
    bar.hidden = (!c || named()) && !worst;
    pick("view-key").hidden = !named() || worst;
    bar.querySelector("i").style.display = worst ? "none" : "";
    const sign = judge.worst === "high" ? "from" : "up to";
    [words[0].textContent, words[1].textContent, words[2].textContent] = worst
      ? ["", "", `red: the worst 1 % by ${judge.name}, ${sign} ${say(judge.threshold, judge)}`]
      : c ? [say(c.low, c), say(c.high, c), `${c.name}; the bar spans the 1st to the 99th percentile; `
        + `all values lie between ${say(c.least, c)} and ${say(c.largest, c)}`] : ["", "", ""];
    redraw();
  };
  const choose = () => {
    const select = pick("view-colour"), before = select.selectedOptions[0]?.textContent, names = mesh().colours.map(c => c.name);
    select.replaceChildren(new Option("plain", ""), ...names.map((name, k) => new Option(name, k)));
    const kept = names.indexOf(before);
    select.value = kept >= 0 ? String(kept) : mesh().within ? "0" : "";
    recolour();
  };

  // --- orientation cube and scale bar
  const corners = [[-1, -1], [1, -1], [1, 1], [-1, 1]];
  const sides = [0, 1, 2].flatMap(axis => [1, -1].map(sign => ({ axis, sign, letter: about.letters[axis][sign > 0 ? 0 : 1] })));
  const looks = { "0 1": [Math.PI / 2, 0], "0 -1": [-Math.PI / 2, 0], "1 1": [Math.PI, 0], "1 -1": [0, 0], "2 1": [0, Math.PI / 2], "2 -1": [0, -Math.PI / 2] };
  const svg = (name, attributes) => {
    const element = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const key in attributes) element.setAttribute(key, attributes[key]);
    return element;
  };
  for (const side of sides) {
    side.group = svg("g", { tabindex: 0, role: "button", "aria-label": `Look from ${side.letter}` });
    side.face = svg("polygon", {}); side.text = svg("text", { "text-anchor": "middle", dy: 5 }); side.text.textContent = side.letter;
    side.group.append(side.face, side.text); pick("view-cube").append(side.group);
    const look = () => { [camera.yaw, camera.pitch] = looks[`${side.axis} ${side.sign}`]; redraw(); };
    side.group.addEventListener("click", look);
    side.group.addEventListener("keydown", e => { if (e.key === "Enter" || e.key === " ") { e.preventDefault(); look(); } });
  }
  const cube = () => {
    const m = turn(), project = p => [0, 1].map(row => (m[row] * p[0] + m[3 + row] * p[1] + m[6 + row] * p[2]) * (row ? -26 : 26));
    for (const side of sides) {
      const towards = side.sign * m[3 * side.axis + 2];
      side.group.style.display = towards > 0.02 ? "" : "none";
      const place = (u, v, out) => { const p = [0, 0, 0]; p[side.axis] = out * side.sign; p[(side.axis + 1) % 3] = u; p[(side.axis + 2) % 3] = v; return project(p); };
      side.face.setAttribute("points", corners.map(([u, v]) => place(u, v, 1).map(c => c.toFixed(1)).join(",")).join(" "));
      const [x, y] = place(0, 0, 1);
      side.text.setAttribute("x", x.toFixed(1)); side.text.setAttribute("y", y.toFixed(1));
      side.text.style.opacity = Math.min(1, 2.5 * towards).toFixed(2);
    }
  };
  const ruler = () => {
    const perPixel = about.half / (0.5 * canvas.clientHeight * scale()), most = 130 * perPixel, power = 10 ** Math.floor(Math.log10(most));
    const length = [5, 2, 1].map(m => m * power).find(l => l <= most);
    pick("view-ruler").querySelector("i").style.width = `${(length / perPixel).toFixed(1)}px`;
    pick("view-ruler").querySelector("span").textContent = `${+length.toPrecision(2)} mm`;
  };

  // --- the value under the pointer: the number of each triangle is drawn as a colour, when it is asked for after a change
  const target = gl.createFramebuffer(), image = gl.createTexture(), depth = gl.createRenderbuffer();
  const under = (x, y) => {
    const w = canvas.clientWidth, h = canvas.clientHeight;
    if (x < 0 || y < 0 || x >= w || y >= h) return -1;
    if (!picked) {
      gl.bindFramebuffer(gl.FRAMEBUFFER, target);
      gl.bindTexture(gl.TEXTURE_2D, image); gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, w, h, 0, gl.RGBA, gl.UNSIGNED_BYTE, null);
      gl.bindRenderbuffer(gl.RENDERBUFFER, depth); gl.renderbufferStorage(gl.RENDERBUFFER, gl.DEPTH_COMPONENT24, w, h);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, image, 0);
      gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.RENDERBUFFER, depth);
      paint(true, w, h);
      picked = new Uint8Array(4 * w * h); gl.readPixels(0, 0, w, h, gl.RGBA, gl.UNSIGNED_BYTE, picked);
      gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    }
    const i = 4 * ((h - 1 - Math.floor(y)) * w + Math.floor(x));
    return (picked[i] | picked[i + 1] << 8 | picked[i + 2] << 16) - 1;
  };
  const read = e => {
    const box = canvas.getBoundingClientRect(), n = under(e.clientX - box.left, e.clientY - box.top), out = pick("view-value"), m = mesh();
    if (n < 0) { out.textContent = "Point at the mesh to read its values."; return; }
    const centre = [0, 1, 2].map(k => about.centre[k] + about.half * (m.position[9 * n + k] + m.position[9 * n + 3 + k] + m.position[9 * n + 6 + k]) / 3);
    const values = m.colours.map(c => `${c.name}: ${say(c.on_triangles ? c.values[n] : (c.values[m.t[3 * n]] + c.values[m.t[3 * n + 1]] + c.values[m.t[3 * n + 2]]) / 3, c)}`);
    const where = centre.map((v, k) => about.anatomical ? `${about.letters[k][v < 0 ? 1 : 0]} ${Math.abs(v).toFixed(1)}` : `${"xyz"[k]} ${v.toFixed(1)}`);
    out.textContent = `${values.join(", ")}; at ${where.join(", ")} mm`;
  };

  // --- mouse, fingers, keys: nothing is taken from who only wants to scroll by
  const clamp = () => { camera.pitch = Math.max(-1.5708, Math.min(1.5708, camera.pitch)); camera.zoom = Math.max(0.3, Math.min(80, camera.zoom)); };
  const unit = () => 2 / scale() / canvas.clientHeight;
  const rotate = (dx, dy) => { camera.yaw -= 0.008 * dx; camera.pitch += 0.008 * dy; };
  const move = (dx, dy) => { camera.x += dx * unit(); camera.y -= dy * unit(); };
  let last = null, reading = false;
  canvas.addEventListener("pointerdown", e => {
    if (e.pointerType === "touch") return read(e);
    canvas.setPointerCapture(e.pointerId); last = e; canvas.focus({ preventScroll: true });
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => { last = null; });
  canvas.addEventListener("pointermove", e => {
    if (e.pointerType === "touch") return;
    if (!last) {
      if (!reading) { reading = true; requestAnimationFrame(() => { reading = false; if (!last && !waiting) read(e); }); }
      return;
    }
    (e.shiftKey || e.buttons & 6 ? move : rotate)(e.clientX - last.clientX, e.clientY - last.clientY);
    last = e; clamp(); redraw();
  });
  let fingers = null;
  const middle = touches => [0.5 * (touches[0].clientX + touches[1].clientX), 0.5 * (touches[0].clientY + touches[1].clientY),
    Math.hypot(touches[0].clientX - touches[1].clientX, touches[0].clientY - touches[1].clientY)];
  canvas.addEventListener("touchstart", e => { fingers = e.touches.length === 2 ? middle(e.touches) : null; if (fingers) e.preventDefault(); }, { passive: false });
  canvas.addEventListener("touchmove", e => {
    if (e.touches.length !== 2 || !fingers) return;
    e.preventDefault();
    const now = middle(e.touches);
    rotate(now[0] - fingers[0], now[1] - fingers[1]); camera.zoom *= now[2] / Math.max(1, fingers[2]);
    fingers = now; clamp(); redraw();
  }, { passive: false });
  for (const end of ["touchend", "touchcancel"]) canvas.addEventListener(end, () => { fingers = null; });
  canvas.addEventListener("wheel", e => {
    if (!e.ctrlKey && document.activeElement !== canvas) return;
    e.preventDefault(); camera.zoom *= Math.exp(-0.0012 * e.deltaY); clamp(); redraw();
  }, { passive: false });
  canvas.addEventListener("contextmenu", e => e.preventDefault());
  const reset = () => { camera = start(); redraw(); };
  canvas.addEventListener("dblclick", reset); pick("view-reset").addEventListener("click", reset);
  const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
  canvas.addEventListener("keydown", e => {
    if (e.key === "Escape") return canvas.blur();
    if (e.ctrlKey || e.metaKey || e.altKey) return;
    if (arrows[e.key]) { const [x, y] = arrows[e.key]; e.shiftKey ? move(20 * x, 20 * y) : rotate(12 * x, 12 * y); }
    else if (e.key === "+" || e.key === "=") camera.zoom *= 1.2;
    else if (e.key === "-") camera.zoom /= 1.2;
    else if (e.key === "0") camera = start();
    else return;
    e.preventDefault(); clamp(); redraw();
  });
  pick("view-mesh").addEventListener("change", choose);
  for (const id of ["view-colour", "view-worst"]) pick(id).addEventListener("change", recolour);
  pick("view-edges").addEventListener("change", redraw);
  pick("view-clip").addEventListener("change", () => { pick("view-depth").disabled = pick("view-clip").value === ""; redraw(); });
  pick("view-depth").addEventListener("input", redraw);
  new ResizeObserver(redraw).observe(canvas);
  choose(); draw();
})().catch(error => {
  document.getElementById("view").dataset.state = "failed";
  document.getElementById("view-note").textContent = `The 3-D view cannot be drawn: ${error.message}`;
  throw error;
});
