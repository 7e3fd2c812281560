// The page's controls: what is shown is one `state`, kept in the address after # so that a view can be sent.

const element = (id) => document.getElementById(id);
const packed = JSON.parse(element("report-data").textContent);

// Replace every encoded array in the payload by its numbers.
function unpack(value) {
  if (value === null || typeof value !== "object") return value;
  if (typeof value.data === "string" && value.dtype) return decode(value);
  if (Array.isArray(value)) return value.map(unpack);
  return Object.fromEntries(Object.entries(value).map(([key, inner]) => [key, unpack(inner)]));
}

const data = unpack(packed), passes = data.passes, motion = data.motion, panel = data.panel;
const canvas = element("canvas"), viewer = createViewer(data, canvas);
const duration = motion.time[motion.time.length - 1];
const state = { view: "blade", quantity: "force", time: motion.time[0], waypoint: null, lines: true, range: [0, 1], grey: rgb(data.notGround) };
const chosen = () => data.quantities.find((item) => item.key === state.quantity);
const passOf = (waypoint) => passes.first.findIndex((first, j) => j + 1 < passes.first.length && waypoint < passes.first[j + 1]);
const told = (value, decimals, unit) => (Number.isFinite(value) ? value.toFixed(decimals) + (unit ? " " + unit : "") : "not known");

function make(tag, text, name) {
  const made = document.createElement(tag);
  made.textContent = text;
  if (name) made.className = name;
  return made;
}

function sampleAt(time) {
  let low = 0, high = motion.time.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (motion.time[middle] <= time) low = middle; else high = middle;
  }
  return time - motion.time[low] < motion.time[high] - time ? low : high;
}

function showLegend() {
  const item = chosen(), [low, high] = item.range, legend = element("legend").getContext("2d"), image = legend.createImageData(256, 1);
  image.data.set(colourBytes(data.colours));
  legend.putImageData(image, 0, 0);
  element("legend-title").textContent = item.label + (item.unit ? ", " + item.unit : "");
  element("legend-ticks").replaceChildren(...[0, 0.25, 0.5, 0.75, 1].map((share) => {
    const tick = make("span", (low + share * (high - low)).toFixed(item.decimals));
    tick.style.left = 100 * share + "%";
    return tick;
  }));
}

function showReadout() {
  const i = sampleAt(state.time), contact = motion.contact[i] === 1;
  const rows = [["Time", state.time.toFixed(2) + " s"], ["Line", contact ? String(motion.line[i]) : "in the air"]];
  rows.push(["Force", contact ? told(motion.force[i], 2) + " ± " + told(motion.force_sd[i], 2, "N") : "none"]);
  rows.push(["Feed", contact ? told(motion.feed_mm_s[i], 1, "mm/s") : "none"]);
  for (let a = 0; a < 6; a++) rows.push(["A" + (a + 1), told(motion.q_deg[6 * i + a], 2, "deg")]);
  element("readout").replaceChildren(...rows.map(([name, text]) => {
    const row = make("div", "");
    row.append(make("dt", name), make("dd", text));
    return row;
  }));
}

function showHover(views) {
  const box = element("hover"), i = state.waypoint;
  box.hidden = i === null;
  document.querySelectorAll(".panels svg").forEach((svg) => {
    const here = i !== null && Number(svg.dataset.pass) === passOf(i), force = data.quantities[0].values, sd = data.quantities[1].values;
    const x = here ? panel.left + (panel.span * passes.s[i]) / panel.longest : -9;
    svg.querySelector(".cursor").setAttribute("x1", x);
    svg.querySelector(".cursor").setAttribute("x2", x);
    svg.parentNode.querySelector(".pointed").textContent = here
      ? told(force[i], 2) + " ± " + told(sd[i], 2, "N") + " at " + told(1e3 * passes.s[i], 1, "mm") : "";
  });
  if (i === null) return;
  const j = passOf(i), rows = data.quantities.map((item) => {
    const row = make("div", "", item.key === state.quantity ? "chosen" : "");
    row.append(make("span", item.label), make("span", told(item.values[i], item.decimals, item.unit)));
    return row;
  });
  box.replaceChildren(make("b", "Line " + passes.line[j] + " (" + passes.side[j] + "), " + (1e3 * passes.s[i]).toFixed(1) + " mm along"), ...rows);
  const p = passes.p.subarray(3 * i, 3 * i + 3), n = passes.n.subarray(3 * i, 3 * i + 3);
  const at = views.map((view) => viewer.pixel(view, p, n)).find(Boolean) || { x: 0, y: 0 };
  const left = at.x + 18 + box.offsetWidth > canvas.clientWidth ? at.x - 18 - box.offsetWidth : at.x + 18;
  box.style.left = Math.max(left, 4) + "px";
  box.style.top = clamp(at.y - box.offsetHeight / 2, 4, Math.max(canvas.clientHeight - box.offsetHeight - 4, 4)) + "px";
}

// Numbers of the lines at their starts, and which side is seen. A number that would cover what is drawn before it is not shown.
function showLabels(views) {
  const made = [], captions = [];
  for (const view of state.view === "blade" ? views : []) {
    const towards = {};
    for (let j = 0; j + 1 < passes.first.length; j++) {
      const i = 3 * passes.first[j], n = passes.n.subarray(i, i + 3), back = scale(passes.t.subarray(i, i + 3), -0.5 * passes.spacing);
      const at = state.lines && viewer.pixel(view, add(passes.p.subarray(i, i + 3), back), n);
      towards[passes.side[j]] = (towards[passes.side[j]] || 0) + dot(n, unit(sub(view.eye, passes.p.subarray(i, i + 3))));
      if (!at) continue;
      made.push(make("span", passes.line[j]));
      [made[made.length - 1].style.left, made[made.length - 1].style.top] = [at.x + "px", at.y + "px"];
    }
    const side = Object.keys(towards).reduce((a, b) => (towards[b] > towards[a] ? b : a));
    const caption = make("span", towards[side] > 0 ? side : "", "caption");
    [caption.style.left, caption.style.top] = [100 * (view.left + view.width / 2) + "%", "8px"];
    captions.push(caption);
  }
  element("labels").replaceChildren(...captions, ...made);
  const shown = captions.map((one) => one.getBoundingClientRect());
  const boxes = made.map((one) => one.getBoundingClientRect());
  boxes.forEach((box, k) => {
    const covers = shown.some((a) => a.left < box.right && box.left < a.right && a.top < box.bottom && box.top < a.bottom);
    if (covers) made[k].remove(); else shown.push(box);
  });
}

let waiting = false;
function redraw() {
  if (waiting || !viewer) return;
  waiting = true;
  requestAnimationFrame(() => {
    waiting = false;
    viewer.draw(state);
    const views = viewer.views(state);
    showLabels(views);
    showHover(views);
    showReadout();
  });
}

// Bring controls, colours and address in line with the state.
function apply() {
  const cell = state.view !== "blade";
  document.querySelectorAll("[name=view]").forEach((radio) => { radio.checked = radio.value === state.view; });
  element("quantity").value = state.quantity;
  element("lines").checked = state.lines;
  element("time").value = (1000 * (state.time - motion.time[0])) / (duration - motion.time[0]);
  element("time").setAttribute("aria-valuetext", state.time.toFixed(2) + " s");
  element("clock").hidden = element("cell-note").hidden = !cell;
  state.range = chosen().range;
  if (viewer) viewer.paint(chosen().values);
  showLegend();
  redraw();
}

function keepInAddress() {
  const words = new URLSearchParams({ view: state.view, quantity: state.quantity, time: state.time.toFixed(2) });
  if (state.waypoint !== null) words.set("waypoint", state.waypoint);
  try { history.replaceState(null, "", "#" + words); } catch (error) { /* some browsers refuse this for local files */ }
}

function readAddress() {
  const words = new URLSearchParams(location.hash.slice(1)), time = parseFloat(words.get("time")), waypoint = parseInt(words.get("waypoint"), 10);
  if (["blade", "cell", "wheel"].includes(words.get("view"))) state.view = words.get("view");
  if (data.quantities.some((item) => item.key === words.get("quantity"))) state.quantity = words.get("quantity");
  if (Number.isFinite(time)) state.time = clamp(time, motion.time[0], duration);
  if (waypoint >= 0 && waypoint < passes.s.length) state.waypoint = waypoint;
}

let playing = false;
function play() {
  playing = !playing;
  element("play").textContent = playing ? "Pause" : "Play";
  if (playing && state.time >= duration) state.time = motion.time[0];
  let before = null;
  const tick = (now) => {
    if (!playing) return;
    if (before !== null) setTime(state.time + ((now - before) / 1000) * Number(element("speed").value));
    before = now;
    if (state.time >= duration) play(); else requestAnimationFrame(tick);
  };
  if (playing) requestAnimationFrame(tick); else keepInAddress();
}

function setTime(time) {
  state.time = clamp(time, motion.time[0], duration);
  element("time").value = (1000 * (state.time - motion.time[0])) / (duration - motion.time[0]);
  element("time").setAttribute("aria-valuetext", state.time.toFixed(2) + " s");
  redraw();
}

function change(key, value) {
  state[key] = value;
  apply();
  keepInAddress();
}

function point(x, y) {
  const found = x === null ? null : viewer.pick(state, x, y);
  if (found !== state.waypoint) {
    state.waypoint = found;
    redraw();
  }
}

// Pointing at a force panel marks the same waypoint in the 3D view.
function pointAtPanel(svg, event) {
  const j = Number(svg.dataset.pass), box = svg.getBoundingClientRect();
  const s = ((((event.clientX - box.left) / box.width) * panel.width - panel.left) / panel.span) * panel.longest;
  let best = passes.first[j];
  for (let i = best; i < passes.first[j + 1]; i++) if (Math.abs(passes.s[i] - s) < Math.abs(passes.s[best] - s)) best = i;
  state.waypoint = best;
  redraw();
}

function listen() {
  document.querySelectorAll("[name=view]").forEach((radio) => radio.addEventListener("change", () => change("view", radio.value)));
  element("quantity").addEventListener("change", (event) => change("quantity", event.target.value));
  element("lines").addEventListener("change", (event) => change("lines", event.target.checked));
  element("time").addEventListener("input", (event) => setTime(motion.time[0] + (event.target.value / 1000) * (duration - motion.time[0])));
  element("time").addEventListener("change", keepInAddress);
  element("play").addEventListener("click", play);
  const reset = () => { resetCamera(viewer.cameras[state.view]); redraw(); };
  element("reset").addEventListener("click", reset);
  window.addEventListener("resize", redraw);
  window.addEventListener("hashchange", () => { readAddress(); apply(); });
  document.querySelectorAll(".panels svg").forEach((svg) => {
    svg.addEventListener("pointermove", (event) => pointAtPanel(svg, event));
    svg.addEventListener("pointerleave", () => { state.waypoint = null; redraw(); });
  });
  attachOrbit(canvas, {
    camera: () => viewer.cameras[state.view],
    viewAt: (x) => viewer.views(state).findLast((view) => x >= view.left * canvas.clientWidth),
    changed: redraw,
    point,
    reset,
    step: (direction) => {
      const next = state.waypoint === null ? 0 : state.waypoint + direction;
      state.waypoint = (next + passes.s.length) % passes.s.length;
    },
  });
}

readAddress();
if (viewer) {
  listen();
} else {
  canvas.hidden = true;
  canvas.parentNode.classList.add("flat");
  element("fallback").hidden = false;
  document.querySelectorAll(".bar, .legend, .hint").forEach((part) => { part.hidden = true; });
}
apply();
