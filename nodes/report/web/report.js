// The report's script: the 3D view, the moving tool and the charts of the axes. Units as in the scene: mm, degrees, s.
'use strict';

const scene = JSON.parse(document.getElementById('scene').textContent);
const find = (id) => document.getElementById(id);
const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

/* ---- data ---- */

async function arrays() {
  const text = atob(find('data').textContent.trim());
  const packed = Uint8Array.from(text, (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream('gzip'));
  const bytes = await new Response(stream).arrayBuffer();
  const kinds = { u8: Uint8Array, u16: Uint16Array, i16: Int16Array, u32: Uint32Array, f32: Float32Array };
  return Object.fromEntries(scene.arrays.map((a) => [a.name, new kinds[a.kind](bytes, a.at, a.count)]));
}

// Positions in mm from their whole numbers.
function placed(whole) {
  const mm = new Float32Array(whole.length);
  for (let i = 0; i < whole.length; i++) mm[i] = scene.origin[i % 3] + whole[i] * scene.size[i % 3];
  return mm;
}

const rgb = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16) / 255);

/* ---- colours, the same in the legend and in the shader ---- */

const RADIUS_LIMIT = 500;

// MATLAB's jet over a radius within ±500 mm, as in the paper: dark red at 500 mm and above.
function radiusColour(radius) {
  const t = clamp(radius / RADIUS_LIMIT, -1, 1) * 0.5 + 0.5;
  return [3, 2, 1].map((peak) => clamp(1.5 - Math.abs(4 * t - peak), 0, 1));
}

const LEFT = { white: [0.97, 0.97, 0.97], red: [0.70, 0.09, 0.17], over: [0.36, 0.0, 0.42], blue: [0.13, 0.40, 0.67], under: [0.02, 0.10, 0.30] };

function leftoverColour(left) {
  const over = left > scene.scallop_height * 1.0005, under = left < -scene.gouge_tolerance * 1.0005;
  if (over || under) return over ? LEFT.over : LEFT.under;
  const share = left > 0 ? left / scene.scallop_height : -left / scene.gouge_tolerance;
  const end = left > 0 ? LEFT.red : LEFT.blue;
  return LEFT.white.map((w, k) => w + (end[k] - w) * share);
}

const VERTEX = `
attribute vec3 colour; attribute float curvature; attribute float leftover; attribute float known;
varying vec3 vColour; varying vec3 vNormal; varying float vCurvature; varying float vLeftover; varying float vKnown;
void main() {
  vColour = colour; vCurvature = curvature; vLeftover = leftover; vKnown = known;
  vNormal = normalMatrix * normal;
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
}`;
const FRAGMENT = `
uniform int layer; uniform float scallop; uniform float gouge; uniform vec3 plain;
varying vec3 vColour; varying vec3 vNormal; varying float vCurvature; varying float vLeftover; varying float vKnown;
vec3 radiusColour(float k) {
  float r = abs(k) > 1.0 / ${RADIUS_LIMIT}.0 ? 1.0 / k : (k < 0.0 ? -${RADIUS_LIMIT}.0 : ${RADIUS_LIMIT}.0);
  float t = r / ${RADIUS_LIMIT}.0 * 0.5 + 0.5;
  return clamp(1.5 - abs(4.0 * t - vec3(3.0, 2.0, 1.0)), 0.0, 1.0);
}
vec3 leftoverColour(float l) {
  if (l > scallop * 1.0005) return vec3(${LEFT.over});
  if (l < -gouge * 1.0005) return vec3(${LEFT.under});
  return l > 0.0 ? mix(vec3(${LEFT.white}), vec3(${LEFT.red}), l / scallop) : mix(vec3(${LEFT.white}), vec3(${LEFT.blue}), -l / gouge);
}
void main() {
  vec3 base = plain;
  if (layer == 0) base = vColour;
  if (layer == 1) base = radiusColour(vCurvature);
  if (layer == 2) base = vKnown > 0.99 ? leftoverColour(vLeftover) : vec3(0.5);
  vec3 n = normalize(vNormal);
  if (!gl_FrontFacing) { n = -n; base = mix(base, vec3(0.35), 0.6); }
  float light = 0.50 + 0.38 * max(dot(n, normalize(vec3(-0.35, 0.55, 0.75))), 0.0) + 0.18 * max(n.z, 0.0);
  gl_FragColor = vec4(min(base * light, 1.0), 1.0);
}`;

/* ---- the view ---- */

function surfaceMesh(data) {
  const positions = placed(data.vertices);
  const smooth = new THREE.BufferGeometry();
  smooth.setAttribute('position', new THREE.BufferAttribute(positions, 3));
  smooth.setIndex(new THREE.BufferAttribute(data.triangles, 1));
  smooth.computeVertexNormals();
  const normals = smooth.getAttribute('normal').array;
  const corners = data.triangles.length;
  const out = { position: new Float32Array(corners * 3), normal: new Float32Array(corners * 3), colour: new Float32Array(corners * 3),
    curvature: new Float32Array(corners), leftover: new Float32Array(corners), known: new Float32Array(corners) };
  const colours = new Map(scene.patches.map((p) => [p.number, rgb(p.colour)]));
  for (let i = 0; i < corners; i++) {
    const v = data.triangles[i];
    const colour = colours.get(data.patches[Math.floor(i / 3)]) || [0.62, 0.62, 0.62];
    for (let k = 0; k < 3; k++) {
      out.position[3 * i + k] = positions[3 * v + k];
      out.normal[3 * i + k] = normals[3 * v + k];
      out.colour[3 * i + k] = colour[k];
    }
    out.curvature[i] = data.curvature[v] * scene.curvature_step;
    out.known[i] = data.leftover[v] === -32768 ? 0 : 1;
    out.leftover[i] = out.known[i] ? data.leftover[v] * scene.leftover_step : 0;
  }
  const geometry = new THREE.BufferGeometry();
  for (const [name, values] of Object.entries(out)) {
    geometry.setAttribute(name, new THREE.BufferAttribute(values, values.length === corners ? 1 : 3));
  }
  const material = new THREE.ShaderMaterial({
    vertexShader: VERTEX, fragmentShader: FRAGMENT, side: THREE.DoubleSide, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 2,
    uniforms: { layer: { value: 0 }, scallop: { value: scene.scallop_height }, gouge: { value: scene.gouge_tolerance }, plain: { value: new THREE.Vector3(0.66, 0.69, 0.73) } },
  });
  return new THREE.Mesh(geometry, material);
}

function passLines(data) {
  const positions = placed(data.pass_points);
  const colours = new Float32Array(positions.length);
  const index = [];
  const shades = new Map(scene.patches.map((p) => [p.number, rgb(p.passes)]));
  let first = 0;
  data.pass_counts.forEach((count, line) => {
    const shade = shades.get(data.pass_patches[line]) || [0, 0, 0];
    for (let i = first; i < first + count; i++) {
      shade.forEach((c, k) => { colours[3 * i + k] = c; });
      if (i > first) index.push(i - 1, i);
    }
    first += count;
  });
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute('position', new THREE.BufferAttribute(positions, 3));
  geometry.setAttribute('color', new THREE.BufferAttribute(colours, 3));
  geometry.setIndex(index);
  const material = new THREE.ShaderMaterial({
    vertexShader: 'attribute vec3 color; varying vec3 c; void main() { c = color; gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0); }',
    fragmentShader: 'varying vec3 c; uniform float own; void main() { gl_FragColor = mix(vec4(0.08, 0.09, 0.11, 0.45), vec4(c, 1.0), own); }',
    uniforms: { own: { value: 1 } }, transparent: true,
  });
  return new THREE.LineSegments(geometry, material);
}

// Glassy, so that it hides nothing of the surface; its own back is not drawn.
function turned(profile, colour, opacity) {
  const geometry = new THREE.LatheGeometry(profile.map(([r, z]) => new THREE.Vector2(r, z)), 64);
  geometry.rotateX(Math.PI / 2);
  return new THREE.Mesh(geometry, new THREE.MeshLambertMaterial({ color: colour, transparent: true, opacity, depthWrite: opacity > 0.6 }));
}

// The tool over its tip along +z. Where no shank is given, what is above the cutting end is as thick as the cutter: so it was checked.
function toolGroup() {
  const { r1, r2, flutes, shank, holder } = scene.tool;
  const radius = r1 + r2, group = new THREE.Group();
  const top = shank ? flutes : Math.min(Math.max(2 * radius, r2), flutes);
  const profile = [[0, 0], [r1, 0]];
  for (let i = 1; i <= 12; i++) {
    const a = (i / 12) * Math.PI / 2;
    profile.push([r1 + r2 * Math.sin(a), r2 * (1 - Math.cos(a))]);
  }
  profile.push([radius, Math.max(top, r2)], [0, Math.max(top, r2)]);
  group.add(turned(profile, 0xd9a521, 0.8));
  const section = ([low, high, a, b], colour) => { if (high > low) group.add(turned([[0, low], [a, low], [b, high], [0, high]], colour, 0.4)); };
  if (!shank && flutes > top) section([top, flutes, radius, radius], 0x8d949d);
  if (shank) section(shank, 0x8d949d);
  for (const part of holder) section(part, 0x4c5462);
  return group;
}

class View {
  constructor(place, data) {
    this.place = place;
    this.renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
    this.renderer.outputColorSpace = 'srgb';
    this.scene = new THREE.Scene();
    this.surface = surfaceMesh(data);
    this.passes = passLines(data);
    this.tool = toolGroup();
    this.way = new THREE.Line(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ color: 0xd94801 }));
    this.way.geometry.setAttribute('position', new THREE.BufferAttribute(placed(data.tips), 3));
    this.way.visible = false;
    this.way.frustumCulled = false;
    const sun = new THREE.DirectionalLight(0xffffff, 2.2);
    sun.position.set(-0.4, -0.5, 1);
    this.scene.add(this.surface, this.passes, this.tool, this.way, new THREE.HemisphereLight(0xffffff, 0x808890, 1.6), sun);
    const [low, high] = scene.bounds;
    this.middle = new THREE.Vector3(...low.map((v, k) => (v + high[k]) / 2));
    this.reach = Math.max(Math.hypot(...low.map((v, k) => high[k] - v)) / 2, 1);
    this.camera = new THREE.PerspectiveCamera(32, 1, this.reach / 50, this.reach * 60);
    this.camera.up.set(0, 0, 1);
    place.append(this.renderer.domElement);
    this.controls = new THREE.OrbitControls(this.camera, this.renderer.domElement);
    this.controls.enableZoom = false;
    this.controls.minDistance = this.reach / 10;
    this.controls.maxDistance = this.reach * 20;
    this.controls.addEventListener('change', () => this.ask());
    this.controls.addEventListener('start', () => { this.touched = true; });
    // The wheel scrolls the page until the view has the focus.
    place.addEventListener('focus', () => { this.controls.enableZoom = true; });
    place.addEventListener('blur', () => { this.controls.enableZoom = false; });
    place.addEventListener('pointerdown', () => place.focus({ preventScroll: true }));
    new ResizeObserver(() => this.resize()).observe(place);
    this.resize();
  }

  home() {
    this.touched = false;
    const aspect = Math.min(1, this.camera.aspect * 0.92), { r1, r2 } = scene.tool;
    // Of a tool that is larger than the part enough is seen to know it for one.
    const reach = Math.max(this.reach, 1.6 * (r1 + r2));
    this.controls.target.copy(this.middle);
    this.camera.position.copy(this.middle).add(new THREE.Vector3(-0.62, -1.25, 1.15).setLength(reach * 3.3 / aspect));
    this.controls.update();
    this.ask();
  }

  turn(azimuth, height) {
    this.touched = true;
    const way = this.camera.position.clone().sub(this.controls.target);
    const side = new THREE.Vector3().crossVectors(this.camera.up, way).normalize();
    way.applyAxisAngle(this.camera.up, azimuth);
    const angle = way.angleTo(this.camera.up);
    way.applyAxisAngle(side, clamp(angle + height, 0.02, Math.PI - 0.02) - angle);
    this.camera.position.copy(this.controls.target).add(way);
    this.controls.update();
    this.ask();
  }

  zoom(factor) {
    this.touched = true;
    const way = this.camera.position.clone().sub(this.controls.target);
    way.setLength(clamp(way.length() * factor, this.controls.minDistance, this.controls.maxDistance));
    this.camera.position.copy(this.controls.target).add(way);
    this.controls.update();
    this.ask();
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.place;
    if (!width || !height) return;
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    if (!this.touched) this.home();
    this.ask();
  }

  layer(name) {
    const number = ['patches', 'radius', 'residual', 'plain'].indexOf(name);
    this.surface.material.uniforms.layer.value = number;
    this.passes.material.uniforms.own.value = number === 0 ? 1 : 0;
    this.ask();
  }

  move(state) {
    this.tool.position.set(...state.tip);
    this.tool.quaternion.setFromUnitVectors(new THREE.Vector3(0, 0, 1), new THREE.Vector3(...state.axis).normalize());
    this.way.geometry.setDrawRange(0, state.stop + 1);
    this.ask();
  }

  // Draws once, however often it is asked for, at the next frame.
  ask() {
    if (this.asked) return;
    this.asked = true;
    requestAnimationFrame(() => {
      this.asked = false;
      this.renderer.setClearColor(css('--view'));
      this.renderer.render(this.scene, this.camera);
    });
  }
}

/* ---- where the tool is ---- */

class Track {
  constructor(data) {
    this.times = data.times;
    this.joints = data.joints;
    this.tips = placed(data.tips);
    this.axes = data.tool_axes;
  }

  at(time) {
    let low = 0, high = this.times.length - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (this.times[middle] <= time) low = middle; else high = middle;
    }
    const span = this.times[high] - this.times[low];
    const share = span > 0 ? clamp((time - this.times[low]) / span, 0, 1) : 1;
    const mix = (values, width) => Array.from({ length: width }, (_, k) => {
      const a = values[low * width + k], b = values[high * width + k];
      return a + (b - a) * share;
    });
    const speeds = Array.from({ length: 5 }, (_, k) => span > 0 ? (this.joints[high * 5 + k] - this.joints[low * 5 + k]) / span : 0);
    return { stop: share < 1 ? low : high, tip: mix(this.tips, 3), axis: mix(this.axes, 3), joints: mix(this.joints, 5), speeds };
  }
}

/* ---- charts of the axes ---- */

class Charts {
  constructor(place, data, seek) {
    this.plots = [];
    scene.axes.forEach((axis, k) => {
      for (const kind of ['position', 'speed']) this.plots.push(this.plot(place, axis, k, kind, data[kind + '_bands'], seek));
    });
    for (let column = 0; column < 2; column++) place.append(this.seconds());
    find('limits').addEventListener('change', () => this.draw());
    new ResizeObserver(() => this.draw()).observe(place);
    matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => this.draw());
  }

  plot(place, axis, k, kind, bands, seek) {
    const plot = document.createElement('div'), labels = document.createElement('div'), area = document.createElement('div');
    const canvas = document.createElement('canvas'), cursor = document.createElement('div');
    [plot.className, labels.className, area.className, cursor.className] = ['plot', 'labels', 'area', 'cursor'];
    const [top, name, bottom] = ['span', 'b', 'span'].map((tag) => labels.appendChild(document.createElement(tag)));
    name.textContent = `${axis.letter}${kind === 'position' ? axis.unit : axis.speed_unit}`;
    canvas.setAttribute('role', 'img');
    canvas.setAttribute('aria-label', `${kind} of axis ${axis.letter} over time; extremes are in the table below`);
    area.append(canvas, cursor);
    plot.append(labels, area);
    place.append(plot);
    const go = (event) => {
      const box = area.getBoundingClientRect();
      seek(clamp((event.clientX - box.left) / box.width, 0, 1) * scene.duration);
    };
    area.addEventListener('pointerdown', (event) => { area.setPointerCapture(event.pointerId); go(event); });
    area.addEventListener('pointermove', (event) => { if (event.buttons) go(event); });
    return { axis, k, kind, bands, canvas, cursor, top, bottom };
  }

  seconds() {
    const row = document.createElement('div');
    row.className = 'seconds';
    for (let i = 0; i <= 4; i++) row.appendChild(document.createElement('span')).textContent = `${(scene.duration * i / 4).toFixed(0)} s`;
    return row;
  }

  range(plot) {
    const { axis } = plot;
    if (plot.kind === 'speed') return [-axis.speed * 1.08, axis.speed * 1.08];
    const whole = find('limits').checked && axis.limits;
    const [low, high] = whole ? axis.limits : axis.used;
    const room = Math.max((high - low) * 0.08, 0.5);
    return [low - room, high + room];
  }

  draw() {
    for (const plot of this.plots) this.one(plot);
  }

  one(plot) {
    const { canvas, axis, k, bands } = plot, ratio = Math.min(window.devicePixelRatio, 2);
    const width = canvas.clientWidth, height = canvas.clientHeight;
    if (!width) return;
    [canvas.width, canvas.height] = [width * ratio, height * ratio];
    const [low, high] = this.range(plot), pen = canvas.getContext('2d');
    const y = (value) => height - 5 - (value - low) / (high - low) * (height - 5);
    const digits = high - low > 20 ? 0 : 1, speed = plot.kind === 'speed';
    const ends = speed ? [axis.speed, -axis.speed] : [high, low];
    [plot.top.textContent, plot.bottom.textContent] = ends.map((end) => end.toFixed(digits));
    pen.scale(ratio, ratio);
    pen.strokeStyle = css('--grid');
    pen.strokeRect(0.5, 0.5, width - 1, height - 6);
    if (low < 0 && high > 0) line(pen, 0, width, y(0), []);
    pen.strokeStyle = css('--limit');
    const limits = speed ? [-axis.speed, axis.speed] : axis.limits || [];
    for (const limit of limits) if (limit > low && limit < high) line(pen, 0, width, y(limit), [5, 4]);
    pen.fillStyle = pen.strokeStyle = css('--band');
    const x = (part) => part / scene.parts * width;
    pen.beginPath();
    for (let part = 0; part < scene.parts; part++) {
      const at = (part * 5 + k) * 2;
      if (bands[at] > bands[at + 1]) continue;
      const top = y(bands[at + 1]), tall = Math.max(y(bands[at]) - top, 1.2);
      pen.rect(x(part), top - 0.6, Math.max(width / scene.parts, 0.9), tall);
    }
    pen.fill();
    let begin = 0;
    for (const patch of scene.patches) {
      pen.fillStyle = patch.colour;
      pen.fillRect(begin / scene.duration * width, height - 4, (patch.ends - begin) / scene.duration * width, 4);
      begin = patch.ends;
    }
  }

  move(time) {
    const left = `${time / scene.duration * 100}%`;
    for (const plot of this.plots) plot.cursor.style.left = left;
  }
}

function line(pen, from, to, y, dash) {
  pen.setLineDash(dash);
  pen.beginPath();
  pen.moveTo(from, y);
  pen.lineTo(to, y);
  pen.stroke();
  pen.setLineDash([]);
}

/* ---- legend ---- */

function element(tag, className, text) {
  const made = document.createElement(tag);
  made.className = className;
  if (text !== undefined) made.textContent = text;
  return made;
}

function scale(colour, low, high, ticks, text) {
  const stops = Array.from({ length: 41 }, (_, i) => colour(low + (high - low) * i / 40).map((c) => Math.round(c * 255)));
  const bar = element('div', 'scale'), row = element('div', 'ticks');
  bar.style.background = `linear-gradient(to right, ${stops.map((c) => `rgb(${c})`)})`;
  row.append(...ticks.map((tick) => element('span', '', tick)));
  return [bar, row, element('div', '', text)];
}

function legend(layer) {
  const place = find('legend');
  if (layer === 'radius') {
    place.replaceChildren(...scale(radiusColour, -RADIUS_LIMIT, RADIUS_LIMIT, ['≤ −500', 'convex', '0', 'concave', '≥ 500'],
      'Radius of the rolling ball, mm. Dark red and dark blue are flat or nearly so; the nearer to green, the tighter.'));
  } else if (layer === 'residual') {
    const { scallop_height: h, gouge_tolerance: g } = scene, show = (v) => v.toFixed(4);
    place.replaceChildren(...scale((t) => leftoverColour(t < 0 ? t * g : t * h), -1, 1, [`−${show(g)}`, '0', show(h)],
      'Material left by the proof, mm: the worst of the points nearest to each corner. Violet: above the scallop height; dark blue: deeper than allowed; grey: no point near.'));
  } else if (layer === 'patches') {
    const keys = element('div', 'keys');
    scene.patches.forEach((patch, i) => {
      const key = element('span', ''), swatch = element('span', 'swatch');
      swatch.style.background = patch.colour;
      key.append(swatch, String(i + 1));
      keys.append(key);
    });
    place.replaceChildren(keys, element('div', '', 'In cutting order; each is cut with one tool orientation.'));
  } else {
    place.replaceChildren(element('div', '', 'The surface alone.'));
  }
}

/* ---- putting it together ---- */

class Player {
  constructor(track, view, charts) {
    Object.assign(this, { track, view, charts, time: 0, running: false });
    this.slider = find('time');
    this.slider.max = scene.duration;
    this.slider.step = Math.max(scene.duration / 1000, 0.01);
    this.slider.addEventListener('input', () => this.seek(Number(this.slider.value)));
    find('play').addEventListener('click', () => this.toggle());
    this.rows = [...find('readout').querySelectorAll('tr')];
    this.patchRows = [...find('patches').querySelectorAll('tbody tr')];
    this.rows.forEach((row, k) => row.classList.toggle('endless', !scene.axes[k].limits));
    let begin = 0;
    const stops = scene.patches.map((patch) => {
      const from = begin / scene.duration * 100;
      begin = patch.ends;
      return `${patch.colour} ${from}% ${begin / scene.duration * 100}%`;
    });
    find('strip').style.background = `linear-gradient(to right, ${stops.join(', ')}, transparent 0)`;
  }

  seek(time) {
    this.time = clamp(time, 0, scene.duration);
    this.slider.value = this.time;
    const state = this.track.at(this.time);
    if (this.view) this.view.move(state);
    this.charts.move(this.time);
    this.read(state);
  }

  read(state) {
    const patch = scene.patches.findIndex((p) => this.time < p.ends);
    find('now').textContent = `${this.time.toFixed(2)} s of ${scene.duration.toFixed(1)} s` + (patch < 0 ? '' : `, patch ${patch + 1}`);
    this.slider.setAttribute('aria-valuetext', find('now').textContent);
    this.patchRows.forEach((row, i) => row.classList.toggle('now', i === patch));
    scene.axes.forEach((axis, k) => {
      const [, number, gauge, speed] = this.rows[k].children;
      const value = state.joints[k];
      number.textContent = (Math.abs(value) < 5e-4 ? 0 : value).toFixed(axis.decimals) + axis.unit;
      speed.textContent = Math.abs(state.speeds[k] * (axis.unit === '°' ? 1 : 60)).toFixed(0) + axis.speed_unit;
      if (axis.limits) gauge.querySelector('.needle').style.left = `${clamp((value - axis.limits[0]) / (axis.limits[1] - axis.limits[0]), 0, 1) * 100}%`;
    });
  }

  toggle() {
    this.running = !this.running;
    const button = find('play');
    button.textContent = this.running ? 'Pause' : 'Play';
    button.setAttribute('aria-pressed', String(this.running));
    // Stopped and started again before the next frame there would be two.
    cancelAnimationFrame(this.frame);
    if (!this.running) return;
    if (this.time >= scene.duration) this.seek(0);
    let last = performance.now();
    const step = (now) => {
      this.seek(this.time + (now - last) / 1000 * Number(find('speed').value));
      last = now;
      if (this.time >= scene.duration) this.toggle(); else this.frame = requestAnimationFrame(step);
    };
    this.frame = requestAnimationFrame(step);
  }
}

function keys(player, view) {
  const turn = { ArrowLeft: [-0.12, 0], ArrowRight: [0.12, 0], ArrowUp: [0, -0.08], ArrowDown: [0, 0.08] };
  document.addEventListener('keydown', (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const on = event.target, typing = on.closest('button, select, summary, input:not([type="range"])');
    const layer = document.querySelectorAll('#layers input')[Number(event.key) - 1];
    if (layer && !on.closest('select')) {
      layer.checked = true;
      layer.dispatchEvent(new Event('change', { bubbles: true }));
    } else if (event.key === ' ' && !typing) {
      player.toggle();
    } else if (view && on.closest('#canvas') && turn[event.key]) {
      view.turn(...turn[event.key]);
    } else if (view && on.closest('#canvas') && (event.key === '+' || event.key === '-')) {
      view.zoom(event.key === '+' ? 0.87 : 1.15);
    } else if (view && on.closest('#canvas') && event.key === 'Home') {
      view.home();
    } else {
      return;
    }
    event.preventDefault();
  });
}

function shown(data) {
  try {
    const view = new View(find('canvas'), data);
    find('canvas').classList.add('drawn');
    return view;
  } catch (error) {
    console.error(error);
    find('nothing').textContent = 'The 3D view needs WebGL, which this browser does not give; tables and charts below work without it.';
    return null;
  }
}

async function start() {
  const data = await arrays();
  const view = shown(data);
  const charts = new Charts(find('charts'), data, (time) => player.seek(time));
  const player = new Player(new Track(data), view, charts);
  const choose = () => {
    const name = document.querySelector('#layers input:checked').value;
    if (view) view.layer(name);
    legend(name);
  };
  find('layers').addEventListener('change', choose);
  find('parts').addEventListener('change', () => {
    for (const box of find('parts').querySelectorAll('input')) if (view) view[box.name].visible = box.checked;
    if (view) view.ask();
  });
  if (view) matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => view.ask());
  keys(player, view);
  choose();
  // Into the first patch: the tool is on the part.
  player.seek(scene.duration * 0.3);
  document.documentElement.dataset.ready = 'yes';
}

start();
