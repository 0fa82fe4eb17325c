"use strict";
// The mesh in WebGL: turned about a point by pointer, fingers or arrow keys; coloured as photographed, as plain
// shape, or by how many photos see each vertex; rims of holes as lines.
(() => {
  const data = document.getElementById("viewer-mesh");
  if (!data) return;
  const root = document.getElementById("viewer");
  const canvas = root.querySelector("canvas");
  const legend = document.getElementById("viewer-legend");
  // Kept for printing and for pictures of the page.
  const gl = canvas.getContext("webgl", { antialias: true, preserveDrawingBuffer: true });
  if (!gl) {
    legend.textContent = "This browser shows no WebGL: open the mesh itself, dense/0/meshed-tsdf.ply.";
    canvas.hidden = true;
    return;
  }

  const bytes = (name) => Uint8Array.from(atob(data.dataset[name]), (c) => c.charCodeAt(0));
  const numbers = (name, bits) => {
    const array = bytes(name);
    return bits === 32 ? new Uint32Array(array.buffer) : new Uint16Array(array.buffer);
  };
  const bits = 8 * Number(data.dataset.indexBytes);
  if (bits === 32) gl.getExtension("OES_element_index_uint");
  const indexType = bits === 32 ? gl.UNSIGNED_INT : gl.UNSIGNED_SHORT;
  const positions = numbers("positions", 16);
  const triangles = numbers("triangles", bits);
  const holes = numbers("holes", bits);
  const count = positions.length / 3;
  const photographed = bytes("colors");
  const views = bytes("views");
  const fewViews = Number(data.dataset.fewViews);

  // Shares of the longest side, the box's middle at the origin.
  const high = [0, 0, 0];
  for (let i = 0; i < positions.length; ++i) high[i % 3] = Math.max(high[i % 3], positions[i]);
  const points = new Float32Array(positions.length);
  for (let i = 0; i < positions.length; ++i) points[i] = (positions[i] - high[i % 3] / 2) / 65535;
  const radius = Math.hypot(...high) / 2 / 65535;

  const normals = new Float32Array(positions.length);
  for (let t = 0; t < triangles.length; t += 3) {
    const [a, b, c] = [3 * triangles[t], 3 * triangles[t + 1], 3 * triangles[t + 2]];
    const u = [0, 1, 2].map((k) => points[b + k] - points[a + k]);
    const v = [0, 1, 2].map((k) => points[c + k] - points[a + k]);
    const n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    for (const corner of [a, b, c]) for (let k = 0; k < 3; ++k) normals[corner + k] += n[k];
  }

  // As SetHeat() of the page's other diagrams.
  const stops = [[38, 32, 80], [48, 86, 132], [34, 140, 130], [112, 194, 96], [250, 230, 60]];
  const heat = (t) => {
    const at = 4 * Math.min(1, Math.max(0, t));
    const stop = Math.min(3, Math.floor(at));
    return stops[stop].map((from, k) => from + (at - stop) * (stops[stop + 1][k] - from));
  };
  const most = views.reduce((a, b) => Math.max(a, b), 1);
  const plain = new Uint8Array(3 * count).fill(200);
  const seen = new Uint8Array(3 * count);
  for (let i = 0; i < views.length; ++i) seen.set(views[i] < fewViews ? [200, 30, 40] : heat(views[i] / most), 3 * i);
  const modes = {
    color: { colors: photographed, light: 0.25, text: "As photographed." },
    shape: { colors: plain, light: 1, text: "Shape alone." },
    views: { colors: seen, light: 0.5, text: null },
  };

  const shader = (type, source) => {
    const made = gl.createShader(type);
    gl.shaderSource(made, source);
    gl.compileShader(made);
    if (!gl.getShaderParameter(made, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(made));
    return made;
  };
  const program = gl.createProgram();
  gl.attachShader(program, shader(gl.VERTEX_SHADER, `
    attribute vec3 point, normal, color;
    uniform mat4 clip_from_object;
    varying vec3 c, n;
    void main() { c = color; n = normal; gl_Position = clip_from_object * vec4(point, 1.0); }`));
  gl.attachShader(program, shader(gl.FRAGMENT_SHADER, `
    precision mediump float;
    uniform vec3 towards;
    uniform float light;
    uniform vec4 line;
    varying vec3 c, n;
    void main() {
      // Lit from the viewer; the mesh's back side is darker.
      float cosine = dot(normalize(n), towards);
      float shade = cosine >= 0.0 ? 0.35 + 0.65 * cosine : 0.2;
      gl_FragColor = line.a > 0.0 ? vec4(line.rgb, 1.0) : vec4(c * mix(1.0, shade, light), 1.0);
    }`));
  gl.linkProgram(program);
  gl.useProgram(program);

  const buffer = (target, array) => {
    const made = gl.createBuffer();
    gl.bindBuffer(target, made);
    gl.bufferData(target, array, gl.STATIC_DRAW);
    return made;
  };
  const attribute = (name, array, type, normalized) => {
    const made = buffer(gl.ARRAY_BUFFER, array);
    const at = gl.getAttribLocation(program, name);
    gl.enableVertexAttribArray(at);
    gl.vertexAttribPointer(at, 3, type, normalized, 0, 0);
    return made;
  };
  attribute("point", points, gl.FLOAT, false);
  attribute("normal", normals, gl.FLOAT, false);
  const colorBuffer = attribute("color", plain, gl.UNSIGNED_BYTE, true);
  const triangleBuffer = buffer(gl.ELEMENT_ARRAY_BUFFER, triangles);
  const holeBuffer = buffer(gl.ELEMENT_ARRAY_BUFFER, holes);
  const uniform = (name) => gl.getUniformLocation(program, name);

  let turn = 0.6;
  let tilt = 0.45;
  let distance = 2.2 * radius;
  let mode = photographed.length > 0 ? "color" : "shape";
  let asked = false;

  const draw = () => {
    asked = false;
    const width = canvas.clientWidth * window.devicePixelRatio || canvas.width;
    canvas.width = Math.round(width);
    canvas.height = Math.round(width * 0.75);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    // The camera looks at the origin, z up: rows of its axes in the object's frame.
    const [ct, st, cu, su] = [Math.cos(tilt), Math.sin(tilt), Math.cos(turn), Math.sin(turn)];
    const towards = [ct * cu, ct * su, st];
    const right = [-su, cu, 0];
    const up = [-st * cu, -st * su, ct];
    const near = Math.max(distance - 1.2 * radius, 0.01 * radius);
    const far = distance + 1.2 * radius;
    const f = 1.9;
    const a = (far + near) / (near - far);
    const b = (2 * far * near) / (near - far);
    const matrix = [];
    for (let k = 0; k < 3; ++k) matrix.push(0.75 * f * right[k], f * up[k], a * towards[k], -towards[k]);
    matrix.push(0, 0, -a * distance + b, distance);
    gl.uniformMatrix4fv(uniform("clip_from_object"), false, matrix);
    gl.uniform3fv(uniform("towards"), towards);
    gl.uniform1f(uniform("light"), modes[mode].light);
    gl.uniform4f(uniform("line"), 0, 0, 0, 0);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, triangleBuffer);
    gl.drawElements(gl.TRIANGLES, triangles.length, indexType, 0);
    if (document.getElementById("viewer-holes").checked && holes.length > 0) {
      gl.uniform4f(uniform("line"), 0.9, 0.12, 0.16, 1);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, holeBuffer);
      gl.drawElements(gl.LINES, holes.length, indexType, 0);
    }
  };
  const redraw = () => {
    if (!asked) requestAnimationFrame(draw);
    asked = true;
  };

  const buttons = [...root.querySelectorAll("button[data-mode]")];
  const choose = (name) => {
    mode = name;
    gl.bindBuffer(gl.ARRAY_BUFFER, colorBuffer);
    gl.bufferData(gl.ARRAY_BUFFER, modes[mode].colors, gl.STATIC_DRAW);
    for (const button of buttons) button.setAttribute("aria-pressed", button.dataset.mode === name ? "true" : "false");
    if (mode === "views") {
      const ramp = document.createElement("span");
      ramp.className = "ramp";
      ramp.style.background = `linear-gradient(90deg, ${stops.map((c) => `rgb(${c})`).join(", ")})`;
      legend.replaceChildren(`Seen by ${fewViews}`, ramp, `to ${most} photos; red: by fewer than ${fewViews}.`);
    } else {
      legend.textContent = modes[mode].text;
    }
    redraw();
  };
  for (const button of buttons) {
    const name = button.dataset.mode;
    button.hidden = (name === "color" && photographed.length === 0) || (name === "views" && views.length === 0);
    button.addEventListener("click", () => choose(name));
  }
  document.getElementById("viewer-holes").addEventListener("change", redraw);

  const move = (dx, dy) => {
    turn -= 0.01 * dx;
    tilt = Math.min(1.55, Math.max(-1.55, tilt + 0.01 * dy));
    redraw();
  };
  const zoom = (factor) => {
    distance = Math.min(8 * radius, Math.max(0.25 * radius, distance * factor));
    redraw();
  };
  const fingers = new Map();
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, event);
  });
  const spread = () => {
    const [p, q] = [...fingers.values()];
    return Math.hypot(p.clientX - q.clientX, p.clientY - q.clientY);
  };
  canvas.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    if (fingers.size === 2) {
      const apart = spread();
      fingers.set(event.pointerId, event);
      zoom(apart / Math.max(1, spread()));
    } else {
      fingers.set(event.pointerId, event);
      move(event.clientX - before.clientX, event.clientY - before.clientY);
    }
  });
  for (const end of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(end, (event) => fingers.delete(event.pointerId));
  }
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(0.001 * event.deltaY));
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [-12, 0], ArrowRight: [12, 0], ArrowUp: [0, -12], ArrowDown: [0, 12] }[event.key];
    if (!step) return;
    event.preventDefault();
    move(...step);
  });
  window.addEventListener("resize", redraw);
  choose(mode);
  draw();
})();
