// The body of a report page, to be turned: colour by a field, scale of the deformation, steps or
// modes, supports and loads.  Data come from the script element #scene (report/scene.py packs them);
// whatever is a text in them reaches the page through textContent only.
import {
  AmbientLight, BufferAttribute, BufferGeometry, ConeGeometry, CylinderGeometry, DataTexture,
  DirectionalLight, DoubleSide, EdgesGeometry, InstancedMesh, LineBasicMaterial, LineSegments, LinearFilter,
  Matrix4, Mesh, MeshBasicMaterial, MeshLambertMaterial, OrthographicCamera, Quaternion, RGBAFormat,
  Scene, ShaderMaterial, SphereGeometry, Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";

const $ = (id) => document.getElementById(id);

function bytes(text) {
  const raw = atob(text), out = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) out[i] = raw.charCodeAt(i);
  return out.buffer;
}

// Shading by the normal of the drawn triangle, so that it follows the deformation.
const VERTEX = `
  attribute vec3 u;
  attribute float value;
  attribute float known;
  uniform float scale;
  varying float shade;
  varying float sure;
  varying vec3 place;
  void main() {
    vec4 p = modelViewMatrix * vec4(position + scale * u, 1.0);
    place = p.xyz;
    shade = value;
    sure = known;
    gl_Position = projectionMatrix * p;
  }`;
const FRAGMENT = `
  uniform sampler2D colours;
  uniform float plain;
  uniform float turned;
  uniform vec3 grey;
  uniform float limit;
  varying float shade;
  varying float sure;
  varying vec3 place;
  void main() {
    vec3 n = normalize(cross(dFdx(place), dFdy(place)));
    float light = 0.7 + 0.3 * abs(dot(n, normalize(vec3(0.25, 0.35, 1.0))));
    float within = clamp(shade, 0.0, 1.0), s = mix(within, 1.0 - within, turned);
    vec3 c = mix(texture2D(colours, vec2(s * 255.0 / 256.0 + 0.5 / 256.0, 0.5)).rgb, grey,
                 sure < 0.999 ? 1.0 : plain);
    if (limit > 0.0 && plain < 0.5 && sure > 0.999 && abs(shade - limit) < 1.5 * fwidth(shade)) c = vec3(0.82, 0.2, 0.12);
    gl_FragColor = vec4(light * c, 1.0);
  }`;

function start() {
  const data = JSON.parse($("scene").textContent);
  const box = $("viewer"), canvas = $("view");
  const renderer = new WebGLRenderer({ canvas, alpha: true, antialias: true });
  renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2));
  renderer.setClearColor(0x000000, 0);
  const n = data.count, size = data.size;

  // --- the body ---

  const packed = new Uint16Array(bytes(data.points)), points = new Float32Array(3 * n);
  for (let i = 0; i < 3 * n; i++)
    points[i] = data.low[i % 3] + (packed[i] / 65535) * data.span[i % 3];
  const index = new Uint32Array(bytes(data.triangles)), edges = new Uint32Array(bytes(data.edges));
  const geometry = new BufferGeometry(), lines = new BufferGeometry(), grid = new BufferGeometry();
  const position = new BufferAttribute(points, 3);
  const moved = new BufferAttribute(new Float32Array(3 * n), 3);
  const value = new BufferAttribute(new Float32Array(n), 1);
  const known = new BufferAttribute(new Float32Array(n), 1);  // 0: the field has no value there
  for (const g of [geometry, lines, grid]) {
    g.setAttribute("position", position);
    g.setAttribute("u", moved);
    g.setAttribute("value", value);
    g.setAttribute("known", known);
  }
  geometry.setIndex(new BufferAttribute(index, 1));
  lines.setIndex(new BufferAttribute(edges, 1));
  const sides = new Uint32Array(2 * index.length);
  for (let t = 0, k = 0; t < index.length; t += 3)
    for (const [a, b] of [[0, 1], [1, 2], [2, 0]]) { sides[k++] = index[t + a]; sides[k++] = index[t + b]; }
  grid.setIndex(new BufferAttribute(sides, 1));

  const table = new DataTexture(new Uint8Array(bytes(data.colours)), 256, 1, RGBAFormat);
  table.minFilter = table.magFilter = LinearFilter;
  table.needsUpdate = true;
  const scale = { value: 1 };
  const uniforms = { colours: { value: table }, scale, plain: { value: 0 }, turned: { value: 0 }, grey: { value: new Vector3(0.72, 0.75, 0.78) }, limit: { value: 0 } };
  const body = new Mesh(geometry, new ShaderMaterial({
    uniforms, vertexShader: VERTEX, fragmentShader: FRAGMENT, side: DoubleSide,
    polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1,
  }));
  const line = (opacity) => new ShaderMaterial({
    uniforms: { scale, ink: { value: opacity } }, transparent: true, vertexShader: VERTEX,
    fragmentShader: "uniform float ink; void main() { gl_FragColor = vec4(0.08, 0.1, 0.13, ink); }",
  });
  const outline = new LineSegments(lines, line(0.85)), mesh = new LineSegments(grid, line(0.22));
  mesh.visible = false;
  for (const part of [body, outline, mesh]) part.frustumCulled = false;
  const scene = new Scene();
  scene.add(body, outline, mesh, new AmbientLight(0xffffff, 1.6));
  const sun = new DirectionalLight(0xffffff, 1.8);
  scene.add(sun);

  const top = new Mesh(new SphereGeometry(0.011 * size, 16, 12), new MeshBasicMaterial({ color: 0xffffff, depthTest: false }));
  const rim = new Mesh(new SphereGeometry(0.015 * size, 16, 12), new MeshBasicMaterial({ color: 0x111111, depthTest: false }));
  rim.renderOrder = 8; top.renderOrder = 9;  // seen through the body, wherever it is
  top.add(rim);
  const judged = top.clone();  // what to judge by, where the largest value is singular
  scene.add(top, judged);

  // --- supports and loads ---

  const UP = new Vector3(0, 1, 0), glyphs = [];
  for (const group of data.glyphs) {
    const long = (group.load ? 0.13 : 0.055) * size * (group.grow || 1);
    const head = group.load ? 0.3 * long : long, wide = group.load ? 0.085 * long : 0.32 * long;
    const material = new MeshLambertMaterial({ color: group.colour });
    const cone = new ConeGeometry(group.load ? 2 * wide : wide, head, 14).translate(0, -head / 2, 0);
    const parts = [new InstancedMesh(cone, material, group.at.length)];
    if (group.load) {
      const shaft = new CylinderGeometry(0.45 * wide, 0.45 * wide, long - head, 10).translate(0, -(long + head) / 2, 0);
      parts.push(new InstancedMesh(shaft, material, group.at.length));
    }
    parts.forEach((p) => { p.frustumCulled = false; scene.add(p); });
    glyphs.push({ group, parts, long });
  }
  // Rigid obstacles: each stays as far from the body's nearest point as it is.
  const obstacles = data.obstacles.map((one) => {
    const shape = new BufferGeometry();
    shape.setAttribute("position", new BufferAttribute(new Float32Array(bytes(one.points)), 3));
    shape.setIndex(new BufferAttribute(new Uint32Array(bytes(one.triangles)), 1));
    const part = new Mesh(shape, new MeshBasicMaterial({
      color: one.colour, side: DoubleSide, transparent: true, opacity: 0.35, depthWrite: false,
    }));
    part.add(new LineSegments(new EdgesGeometry(shape, 30), new LineBasicMaterial({ color: 0x7d8a97 })));
    part.frustumCulled = false;
    scene.add(part);
    return { part, ways: one.ways };
  });
  function placeObstacles() {
    for (const { part, ways } of obstacles) {
      const [shift, near] = ways[state.frame];
      part.position.fromArray(shift.map((s, i) => s + (scale.value - 1) * near[i]));
    }
  }
  function place(index, into) {
    into.fromArray(points, 3 * index);
    into.x += scale.value * moved.array[3 * index];
    into.y += scale.value * moved.array[3 * index + 1];
    into.z += scale.value * moved.array[3 * index + 2];
    return into;
  }
  function placeGlyphs() {
    const m = new Matrix4(), q = new Quaternion(), one = new Vector3(1, 1, 1), at = new Vector3(), d = new Vector3();
    for (const { group, parts, long } of glyphs) {
      group.at.forEach((vertex, i) => {
        d.fromArray(group.along, 3 * i).normalize();
        if (vertex < 0) at.fromArray(data.middle); else place(vertex, at);
        if (group.tail[i]) at.addScaledVector(d, long);
        m.compose(at, q.setFromUnitVectors(UP, d), one);
        parts.forEach((p) => p.setMatrixAt(i, m));
      });
      parts.forEach((p) => { p.instanceMatrix.needsUpdate = true; });
    }
  }

  // --- fields and frames ---

  const cache = new Map();
  function numbers(kind, frame, name) {
    const key = `${kind} ${frame} ${name}`;
    if (!cache.has(key)) {
      const f = data.frames[frame];
      if (kind === "u") {
        const raw = new Int16Array(bytes(f.u));
        cache.set(key, Float32Array.from(raw, (x) => (x / 32767) * f.largest));
      } else {
        const raw = new Uint16Array(bytes(f.values[name]));
        cache.set(key, Float32Array.from(raw, (x) => (x === 65535 ? NaN : x / 65534)));
      }
    }
    return cache.get(key);
  }
  const state = { frame: data.frames.length - 1, field: data.fields.length ? data.fields[0].name : "", playing: false };
  if (data.modes) state.frame = 0;

  const digits = (x) => {
    if (x === 0) return "0";
    const a = Math.abs(x);
    return a >= 1e5 || a < 1e-3 ? x.toExponential(2) : String(Number(x.toPrecision(4)));
  };
  function refresh() {
    const frame = data.frames[state.frame];
    moved.array.set(numbers("u", state.frame));
    moved.needsUpdate = true;
    const field = data.fields.find((f) => f.name === state.field);
    uniforms.plain.value = field ? 0 : 1;
    $("legend").hidden = !field;
    top.visible = judged.visible = false;
    if (field) {
      uniforms.turned.value = field.least ? 1 : 0;  // what is dangerous is bright
      const room = field.high - field.low || 1, end = room / (field.most - field.low || 1);
      uniforms.limit.value = field.limit ? (field.limit - field.low) / room : 0;
      paint(field.least, uniforms.limit.value);
      const shares = numbers("s", state.frame, field.name);
      let most = -1;
      for (let i = 0; i < n; i++) {
        const sure = !Number.isNaN(shares[i]);
        known.array[i] = sure ? 1 : 0;
        value.array[i] = sure ? shares[i] / end : 0;  // above 1 where it is singular
        if (sure && (most < 0 || (field.least ? shares[i] < shares[most] : shares[i] > shares[most]))) most = i;
      }
      value.needsUpdate = known.needsUpdate = true;
      $("low").textContent = `${digits(field.low / field.factor)} ${field.unit}`;
      const above = field.most > field.high ? " and more where singular" : "";
      $("high").textContent = `${digits(field.high / field.factor)} ${field.unit}${above}`;
      top.visible = most >= 0 && $("marks").checked && field.high > field.low;
      top.userData.vertex = most;
      const share = most < 0 ? 0 : value.array[most], peak = field.low + share * room;
      const judge = state.frame === data.frames.length - 1 ? field.judge : null;
      judged.visible = top.visible && judge !== null && judge.at >= 0;
      judged.userData.vertex = judged.visible ? judge.at : 0;
      const words = field.least ? (share === 1 ? "everywhere at least" : "smallest here") : "largest here";
      const other = !judge ? "" : judge.text ? `: singular; judge by ${judge.text}` : ": singular";
      const limit = field.limit && !field.least ? `; ${field.limit < field.high ? "red: " : ""}allowable ${digits(field.limit / field.factor)} ${field.unit}` : "";
      $("peak").textContent = most < 0 ? "" : `${words} ${digits(peak / field.factor)} ${field.unit}${other}${limit}`;
    }
    if ($("frame")) $("step").textContent = frame.label;
    draw();
  }
  let waiting = false;
  function draw() {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => {
      waiting = false;
      for (const dot of [top, judged]) if (dot.visible) place(dot.userData.vertex, dot.position);
      placeGlyphs();
      placeObstacles();
      sun.position.copy(camera.position).sub(controls.target).add(new Vector3(0.3 * size, 0.5 * size, 0));
      renderer.render(scene, camera);
    });
  }

  // --- camera ---

  const middle = new Vector3().fromArray(data.middle);
  const camera = new OrthographicCamera(-1, 1, 1, -1, -10 * size, 10 * size);
  const controls = new OrbitControls(camera, canvas);
  controls.enableDamping = false;
  controls.addEventListener("change", draw);
  if (data.plane) controls.enableRotate = false;
  function fit(centred = false) {
    const w = box.clientWidth, h = canvas.clientHeight || Math.round(0.62 * w);
    renderer.setSize(w, h, false);
    const right = new Vector3(), up = new Vector3(), d = new Vector3();
    camera.updateMatrixWorld();
    camera.matrixWorld.extractBasis(right, up, d);
    let x = 0, y = 0;
    const ends = [Infinity, -Infinity, Infinity, -Infinity], v = new Vector3();
    for (let i = 0; i < n; i++) {
      place(i, v).sub(middle);
      const a = v.dot(right), b = v.dot(up);
      ends[0] = Math.min(ends[0], a); ends[1] = Math.max(ends[1], a);
      ends[2] = Math.min(ends[2], b); ends[3] = Math.max(ends[3], b);
    }
    if (centred) {
      controls.target.copy(middle).addScaledVector(right, (ends[0] + ends[1]) / 2)
        .addScaledVector(up, (ends[2] + ends[3]) / 2);
      camera.position.copy(controls.target).addScaledVector(d, 3 * size);
      controls.update();
    }
    x = (ends[1] - ends[0]) / 2; y = (ends[3] - ends[2]) / 2;
    const half = 1.08 * Math.max(y, (x * h) / w) + 0.1 * size;
    camera.top = half; camera.bottom = -half;
    camera.right = (half * w) / h; camera.left = -camera.right;
    camera.updateProjectionMatrix();
    draw();
  }
  function look(x, y, z) {
    camera.up.set(0, z && !x && !y ? 1 : 0, z && !x && !y ? 0 : 1);
    if (data.plane) camera.up.set(0, 1, 0);
    controls.target.copy(middle);
    camera.position.set(x, y, z).normalize().multiplyScalar(3 * size).add(middle);
    camera.zoom = 1;
    controls.update();
    fit(true);
  }

  // --- controls ---

  const choice = $("field");
  for (const f of data.fields) {
    const option = document.createElement("option");
    option.value = f.name;
    option.textContent = f.title;
    choice.append(option);
  }
  const none = document.createElement("option");
  none.value = "";
  none.textContent = "no colours";
  choice.append(none);
  choice.value = state.field;
  choice.addEventListener("change", () => { state.field = choice.value; refresh(); });
  const ramp = $("ramp"), pen = ramp.getContext("2d"), shades = new Uint8Array(bytes(data.colours));
  function paint(turned, limit) {
    for (let i = 0; i < 256; i++) {
      const k = 4 * (turned ? 255 - i : i);
      pen.fillStyle = `rgb(${shades[k]},${shades[k + 1]},${shades[k + 2]})`;
      pen.fillRect(i, 0, 1, 1);
    }
    if (limit > 0 && limit < 1) {
      pen.fillStyle = "rgb(209,52,31)";
      pen.fillRect(Math.round(255 * limit) - 2, 0, 4, 1);
    }
  }

  const slider = $("scale");
  slider.min = "0"; slider.max = String(2 * data.scale); slider.step = String(data.scale / 50);
  slider.value = String(data.scale);
  function rescale(factor = 1) {
    scale.value = factor * Number(slider.value);
    const s = Number(slider.value);
    $("times").textContent = s === 0 ? "undeformed" : data.modes ? `${digits(s * data.longest * 100)} % of its length`
      : s === 1 ? "true scale" : `${digits(s)} times`;
    draw();
  }
  slider.addEventListener("input", () => rescale());
  const frame = $("frame");
  if (data.frames.length > 1) {
    frame.max = String(data.frames.length - 1);
    frame.value = String(state.frame);
    frame.addEventListener("input", () => { state.frame = Number(frame.value); refresh(); });
  } else $("frames").hidden = true;
  $("mesh").addEventListener("change", (e) => { mesh.visible = e.target.checked; draw(); });
  $("marks").addEventListener("change", (e) => {
    glyphs.forEach(({ parts }) => parts.forEach((p) => { p.visible = e.target.checked; }));
    refresh();
  });
  const play = $("play");
  play.hidden = !data.modes && data.frames.length < 2;
  function turn(time) {
    if (!state.playing) return;
    if (data.modes) rescale(Math.sin((2 * Math.PI * (time - state.began)) / 2000));
    else {
      const at = Math.floor((time - state.began) / 180) % data.frames.length;
      if (at !== state.frame) { state.frame = at; frame.value = String(at); refresh(); }
    }
    requestAnimationFrame(turn);
  }
  play.addEventListener("click", () => {
    state.playing = !state.playing;
    play.textContent = state.playing ? "stop" : "play";
    play.setAttribute("aria-pressed", String(state.playing));
    if (state.playing) requestAnimationFrame((t) => { state.began = t; turn(t); });
    else rescale();
  });
  const VIEWS = { iso: [0.62, -0.78, 0.5], x: [1, 0, 0], y: [0, -1, 0], z: [0, 0, 1] };
  for (const [name, v] of Object.entries(VIEWS)) {
    $(`from-${name}`).addEventListener("click", () => look(...(data.plane ? VIEWS.z : v)));
    if (data.plane && name !== "z") $(`from-${name}`).hidden = true;
  }

  box.classList.add("live");
  rescale();
  refresh();
  look(...(data.plane ? VIEWS.z : VIEWS.iso));
  new ResizeObserver(() => fit()).observe(box);
  // A mode that stands still looks like a deformed state.
  if (data.modes && !window.matchMedia("(prefers-reduced-motion: reduce)").matches) play.click();
}

if ($("scene")) {
  try {
    start();
  } catch (error) {
    $("viewer").classList.remove("live");
    $("no-webgl").hidden = false;
    console.error(error);
  }
}
