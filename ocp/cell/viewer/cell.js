// The cell's page: arm, wheel, blade and their frames in the postures with which the blade can be touched.

const element = (id) => document.getElementById(id);
const packed = JSON.parse(element("cell-data").textContent);
const data = Object.fromEntries(Object.entries(packed).map(([key, value]) => [key, value && value.dtype ? decode(value) : value]));
const canvas = element("canvas"), renderer = createRenderer(canvas, data.colours);
const count = data.names.length, wheel = data.wheel;
const state = { view: "cell", posture: 0, frames: true, region: false };
const ARM = ["#8d98a3", "#d9894a", "#d9894a", "#d9894a", "#d9894a", "#8d98a3", "#6f7a85"].map(rgb);
const COLOURS = { rim: rgb("#b9aa94"), hub: rgb("#6f7a85"), grid: rgb("#dde2e7"), blade: rgb("#9fb4c8") };
const TRIAD = ["#c0392b", "#1e8449", "#1f5fb4"].map(rgb), ALL = rgb("#1e8449"), SOME = rgb("#d8a200");

// A 3 x 4 pose in row order at `at` of `values` as a matrix.
const poseAt = (values, at) => blendPose(values, at, at, 0);

function build() {
  const triad = [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map((d) => renderer.mesh(capsuleMesh([0, 0, 0], scale(d, data.axes), 0.006)));
  const end = [3, 7, 11].map((i) => data.bladeInFlange[i]);
  const grid = gridLines(0.9, 0, 2, 0.25);
  for (let i = 2; i < grid.length; i += 3) grid[i] = data.floor;
  return {
    triad,
    arm: data.capsules.map((c) => ({ link: c.link, mesh: renderer.mesh(capsuleMesh(c.p0, c.p1, c.radius)) })),
    holder: norm(end) > 0.01 ? renderer.mesh(capsuleMesh([0, 0, 0], end, 0.012)) : null,
    blade: renderer.mesh(bladeMesh(data.vertices, data.faces)),
    rim: renderer.mesh(cylinderMesh(wheel.centre, wheel.axis, wheel.radius, wheel.width)),
    hub: renderer.mesh(cylinderMesh(wheel.centre, wheel.axis, 0.25 * wheel.radius, 1.5 * wheel.width)),
    dot: renderer.mesh(capsuleMesh([0, 0, 0], [0, 0, 0], 0.018)),
    grid: renderer.mesh({ position: grid }),
  };
}

function cameras() {
  const upright = [[1, 0, 0], [0, 1, 0], [0, 0, 1]], contact = add(wheel.centre, scale(wheel.direction, wheel.radius));
  const sideways = Math.atan2(-Math.abs(wheel.axis[1]) - 1e-9, wheel.axis[1] < 0 ? wheel.axis[0] : -wheel.axis[0]);
  return {
    cell: createCamera([0.55 * wheel.centre[0], 0.55 * wheel.centre[1], 0.95], 5.6, sideways + 0.3, 0.2, upright),
    wheel: createCamera(contact, 0.9, sideways + 0.7, 0.25, upright),
    flange: createCamera([0, 0, 0], 1.1, sideways + 0.5, 0.25, upright),
  };
}

const shapes = renderer && build(), camera = cameras();

function poses() {
  const links = [0, 1, 2, 3, 4, 5, 6].map((i) => poseAt(data.links, 84 * state.posture + 12 * i));
  return { links, blade: poseAt(data.blade, 12 * state.posture), wheel: poseAt(data.wheelFrame, 0) };
}

// A pose whose axes are k times as long.
const longer = (M, k) => new Float32Array([...M].map((v, i) => (i < 12 ? k * v : v)));

// Names and poses of the frames; the base's axes are long enough to stick out of it, close up the others are short.
function framesOf(now) {
  const k = state.view === "cell" ? 1 : 0.4, near = [["flange", now.links[6]], ["blade = TOOL", now.blade], ["wheel = BASE", now.wheel]];
  return [["base", longer(IDENTITY, 5)], ...near.map(([name, model]) => [name, longer(model, k)])];
}

function items(now) {
  const found = shapes.arm.map((part) => ({ mesh: part.mesh, model: now.links[part.link], colour: ARM[part.link] }));
  if (shapes.holder) found.push({ mesh: shapes.holder, model: now.links[6], colour: COLOURS.hub });
  found.push({ mesh: shapes.hub, colour: COLOURS.hub }, { mesh: shapes.grid, colour: COLOURS.grid });
  found.push({ mesh: shapes.blade, model: now.blade, colour: COLOURS.blade });
  if (state.region) {
    for (let i = 0; i < data.share.length; i++) {
      if (data.share[i] < 0.5) continue;
      const place = [0, 1, 2].map((k) => data.places[3 * i + k]);
      found.push({ mesh: shapes.dot, model: frame([1, 0, 0], [0, 1, 0], [0, 0, 1], place), colour: data.share[i] > 0.999 ? ALL : SOME, lit: false });
    }
  }
  if (state.frames) {
    for (const [, model] of framesOf(now)) shapes.triad.forEach((mesh, k) => found.push({ mesh, model, colour: TRIAD[k], lit: false }));
  }
  return found.concat({ mesh: shapes.rim, colour: COLOURS.rim, opacity: state.view === "wheel" ? 0.45 : undefined });
}

function view() {
  const now = poses(), own = camera[state.view];
  if (state.view === "flange") own.target = add(own.shift || [0, 0, 0], movePoint(now.links[6], [0, 0, 0.1]));
  return { left: 0, width: 1, items: items(now), now, ...cameraView(own, 0, canvas.clientWidth / canvas.clientHeight) };
}

function showLabels(shown) {
  const made = [];
  for (const [name, model] of state.frames ? framesOf(shown.now) : []) {
    const [x, y, depth] = project(shown.viewProjection, movePoint(model, [0, 0, 1.15 * data.axes]));
    if (depth <= 0 || Math.abs(x) > 0.97 || Math.abs(y) > 0.97) continue;
    const label = document.createElement("span");
    label.textContent = name;
    label.style.left = `${((x + 1) / 2) * canvas.clientWidth}px`;
    label.style.top = `${((1 - y) / 2) * canvas.clientHeight}px`;
    made.push(label);
  }
  element("labels").replaceChildren(...made);
}

function showReadout() {
  const told = [["touches", data.names[state.posture]]];
  for (let i = 0; i < 6; i++) told.push([`A${i + 1}`, `${data.q[6 * state.posture + i].toFixed(1)}°`]);
  element("readout").replaceChildren(...told.map(([name, value]) => {
    const part = document.createElement("div"), title = document.createElement("dt"), text = document.createElement("dd");
    [title.textContent, text.textContent] = [name, value];
    part.append(title, text);
    return part;
  }));
  element("posture").setAttribute("aria-valuetext", data.names[state.posture]);
}

let waiting = false;
function redraw() {
  if (waiting || !renderer) return;
  waiting = true;
  requestAnimationFrame(() => {
    waiting = false;
    const shown = view();
    renderer.draw([shown]);
    showLabels(shown);
    showReadout();
  });
}

function setPosture(k) {
  state.posture = (k + count) % count;
  element("posture").value = state.posture;
  redraw();
}

element("posture").max = count - 1;
showReadout();
if (renderer) {
  document.querySelectorAll("[name=view]").forEach((radio) => radio.addEventListener("change", () => { state.view = radio.value; redraw(); }));
  for (const name of ["frames", "region"]) element(name).addEventListener("change", (event) => { state[name] = event.target.checked; redraw(); });
  element("posture").addEventListener("input", (event) => setPosture(Number(event.target.value)));
  const reset = () => { resetCamera(camera[state.view]); redraw(); };
  element("reset").addEventListener("click", reset);
  window.addEventListener("resize", redraw);
  attachOrbit(canvas, { camera: () => camera[state.view], viewAt: view, changed: redraw, point: () => {}, reset, step: (d) => setPosture(state.posture + d) });
  redraw();
} else {
  canvas.hidden = true;
  canvas.parentNode.classList.add("flat");
  element("fallback").hidden = false;
  document.querySelectorAll(".bar, .clock, .hint").forEach((part) => { part.hidden = true; });
}
