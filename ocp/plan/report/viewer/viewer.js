// What stands in the picture: blade, passes, arm, wheel; where a waypoint appears; which waypoint is under the mouse.

const ARM_COLOURS = ["#8d98a3", "#d9894a", "#d9894a", "#d9894a", "#d9894a", "#8d98a3", "#6f7a85"].map(rgb);
const WHEEL_COLOUR = rgb("#b9aa94"), HOLDER_COLOUR = rgb("#6f7a85"), GRID_COLOUR = rgb("#dde2e7");
const OUTLINE_COLOUR = rgb("#17212b"), MARKER_COLOUR = rgb("#d1300f");

// Value times mask, and mask, per corner of a mesh; `blend` gives a vertex's waypoints and weights (255 = 1), or null.
function paintPairs(source, values, blend) {
  const pairs = new Float32Array(2 * source.length);
  for (let i = 0; i < source.length; i++) {
    let sum = 0, total = 0;
    if (!blend) [sum, total] = Number.isFinite(values[source[i]]) ? [values[source[i]], 1] : [0, 0];
    else for (let k = 4 * source[i]; k < 4 * source[i] + 4; k++) {
      const value = values[blend.waypoint[k]];
      if (blend.weight[k] === 0 || !Number.isFinite(value)) continue;
      sum += blend.weight[k] * value;
      total += blend.weight[k];
    }
    pairs[2 * i] = blend ? sum / 255 : sum;
    pairs[2 * i + 1] = blend ? total / 255 : total;
  }
  return pairs;
}

function createViewer(data, canvas) {
  const renderer = createRenderer(canvas, data.colours);
  if (!renderer) return null;
  const { passes, blade, cell } = data, wheel = cell.wheel;
  const width = Math.max(0.14 * passes.spacing, 0.0003);
  const surface = renderer.mesh(bladeMesh(blade.vertices, blade.faces));
  const left = blade.left.length ? renderer.mesh(bladeMesh(blade.vertices, blade.left)) : null, leftColour = rgb(data.leftOut);
  const outline = renderer.mesh(ribbons(passes, 1.7 * width, 0.00012));
  const strips = renderer.mesh(ribbons(passes, width, 0.0002));
  const marker = renderer.mesh(capsuleMesh([0, 0, 0], [0, 0, 0], 1));
  const rim = renderer.mesh(cylinderMesh(wheel.centre, wheel.axis, wheel.radius, wheel.width));
  const hub = renderer.mesh(cylinderMesh(wheel.centre, wheel.axis, 0.25 * wheel.radius, 1.5 * wheel.width));
  const grid = renderer.mesh({ position: gridLines(0.9, 0, 2, 0.25) });
  const arm = cell.capsules.map((c) => ({ link: c.link, mesh: renderer.mesh(capsuleMesh(c.p0, c.p1, c.radius)) }));
  const holderEnd = [3, 7, 11].map((i) => cell.bladeInFlange[i]);
  const holder = norm(holderEnd) > 0.01 ? renderer.mesh(capsuleMesh([0, 0, 0], holderEnd, 0.012)) : null;
  const cameras = createCameras(data);

  function paint(values) {
    renderer.paint(surface, paintPairs(surface.source, values, blade));
    renderer.paint(strips, paintPairs(strips.source, values, null));
  }

  // Poses of the seven links and of the blade at a time.
  function poses(time) {
    const clock = cell.time;
    let low = 0, high = clock.length - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (clock[middle] <= time) low = middle; else high = middle;
    }
    const share = clamp((time - clock[low]) / (clock[high] - clock[low] || 1), 0, 1);
    const links = [0, 1, 2, 3, 4, 5, 6].map((i) => blendPose(cell.links, 84 * low + 12 * i, 84 * high + 12 * i, share));
    return { links, blade: blendPose(cell.blade, 12 * low, 12 * high, share) };
  }

  function bladeItems(state, model) {
    const items = [{ mesh: surface, model, colour: state.grey, range: state.range }];
    if (left) items.push({ mesh: left, model, colour: leftColour });
    if (state.lines) {
      items.push({ mesh: outline, model, colour: OUTLINE_COLOUR, lit: false });
      items.push({ mesh: strips, model, colour: state.grey, range: state.range, lit: false });
    }
    if (state.waypoint !== null) {
      const i = 3 * state.waypoint, p = movePoint(model, passes.p.subarray(i, i + 3)), r = 1.6 * width;
      items.push({ mesh: marker, model: frame([r, 0, 0], [0, r, 0], [0, 0, r], p), colour: MARKER_COLOUR });
    }
    return items;
  }

  function cellItems(state, now) {
    const items = arm.map((part) => ({ mesh: part.mesh, model: now.links[part.link], colour: ARM_COLOURS[part.link] }));
    if (holder) items.push({ mesh: holder, model: now.links[6], colour: HOLDER_COLOUR });
    items.push({ mesh: hub, colour: HOLDER_COLOUR }, { mesh: grid, colour: GRID_COLOUR }, ...bladeItems(state, now.blade));
    // Close up the contact is seen through the wheel.
    return items.concat({ mesh: rim, colour: WHEEL_COLOUR, opacity: state.view === "wheel" ? 0.45 : undefined });
  }

  // The pictures shown now: the blade from both sides where there is room, or the cell.
  function views(state) {
    const aspect = canvas.clientWidth / canvas.clientHeight, camera = cameras[state.view];
    if (state.view !== "blade") {
      const now = poses(state.time);
      return [{ left: 0, width: 1, model: now.blade, items: cellItems(state, now), ...cameraView(camera, 0, aspect) }];
    }
    const items = bladeItems(state, IDENTITY), both = aspect > 1.1;
    const one = { left: 0, width: both ? 0.5 : 1, model: IDENTITY, items, ...cameraView(camera, 0, both ? aspect / 2 : aspect) };
    return both ? [one, { ...one, left: 0.5, ...cameraView(camera, Math.PI, aspect / 2) }] : [one];
  }

  // Pixel of a point of the blade, or null where its surface faces away.
  function pixel(view, p, n) {
    const place = movePoint(view.model, p);
    if (n && dot(moveDirection(view.model, n), sub(view.eye, place)) <= 0) return null;
    const [x, y, depth] = project(view.viewProjection, place);
    if (depth <= 0 || Math.abs(x) > 1 || Math.abs(y) > 1) return null;
    return { x: (view.left + ((x + 1) / 2) * view.width) * canvas.clientWidth, y: ((1 - y) / 2) * canvas.clientHeight, depth };
  }

  // The waypoint nearest to a pixel, within 16 pixels; of two nearly as near the one in front.
  function pick(state, x, y) {
    let best = null, least = 16;
    for (const view of views(state)) {
      if (x < view.left * canvas.clientWidth || x > (view.left + view.width) * canvas.clientWidth) continue;
      for (let i = 0; i < passes.s.length; i++) {
        const at = pixel(view, passes.p.subarray(3 * i, 3 * i + 3), passes.n.subarray(3 * i, 3 * i + 3));
        const gap = at && Math.hypot(at.x - x, at.y - y);
        if (at && gap < least) [best, least] = [i, gap];
      }
    }
    return best;
  }

  return { cameras, paint, pick, pixel, views, draw: (state) => renderer.draw(views(state)) };
}

// Starting cameras: the blade upright along its longest side with its first side in view, the whole cell, the wheel.
function createCameras({ blade, passes, cell }) {
  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
  blade.vertices.forEach((v, i) => {
    low[i % 3] = Math.min(low[i % 3], v);
    high[i % 3] = Math.max(high[i % 3], v);
  });
  const size = sub(high, low), up = [0, 1, 2].reduce((a, b) => (size[b] > size[a] ? b : a), 0);
  const basis = [1, 2, 3].map((k) => [0, 1, 2].map((i) => (i === (up + k) % 3 ? 1 : 0)));
  let facing = [0, 0, 0];
  for (let i = 0; i < passes.first[1]; i++) facing = add(facing, passes.n.subarray(3 * i, 3 * i + 3));
  const azimuth = Math.atan2(dot(facing, basis[1]), dot(facing, basis[0]));
  const middle = scale(add(low, high), 0.5), upright = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
  const { centre, axis, direction, radius } = cell.wheel, contact = add(centre, scale(direction, radius));
  const sideways = Math.atan2(-Math.abs(axis[1]) - 1e-9, axis[1] < 0 ? axis[0] : -axis[0]);
  return {
    blade: createCamera(middle, 1.06 * norm(size) / (2 * Math.tan(FIELD_OF_VIEW / 2)), azimuth, 0.08, basis),
    cell: createCamera([0.55 * centre[0], 0.55 * centre[1], 0.9], 4.7, sideways + 0.3, 0.2, upright),
    wheel: createCamera(contact, 4.6 * radius, sideways + 0.95, 0.28, upright),
  };
}
