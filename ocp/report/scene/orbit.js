// The camera that goes around a target, and how mouse, touch and keyboard move it.

const FIELD_OF_VIEW = (28 * Math.PI) / 180;

// Camera around `target` at `distance` m; `basis` holds two horizontal directions and up.
function createCamera(target, distance, azimuth, elevation, basis) {
  return { target, distance, azimuth, elevation, basis, start: { target, distance, azimuth, elevation } };
}

function resetCamera(camera) {
  Object.assign(camera, camera.start);
}

// From the target toward the camera; `turn` is added to the azimuth (the second picture looks from behind).
function cameraDirection(camera, turn) {
  const [x, y, up] = camera.basis, a = camera.azimuth + turn, c = Math.cos(camera.elevation);
  return add(add(scale(x, c * Math.cos(a)), scale(y, c * Math.sin(a))), scale(up, Math.sin(camera.elevation)));
}

// Matrices and light of a camera in a picture of the given aspect; a narrow picture is seen from farther away.
function cameraView(camera, turn, aspect) {
  const direction = cameraDirection(camera, turn), distance = camera.distance / Math.min(1, aspect);
  const eye = add(camera.target, scale(direction, distance)), up = camera.basis[2];
  const right = unit(cross(up, direction)), above = cross(direction, right);
  const near = Math.max(0.03 * distance, 0.005);
  return {
    eye,
    right,
    above,
    distance,
    light: unit(add(add(scale(direction, 0.8), scale(above, 0.5)), scale(right, -0.35))),
    viewProjection: multiply(perspective(FIELD_OF_VIEW, aspect, near, distance + 12), lookAt(eye, camera.target, up)),
  };
}

// Move the target by a drag of (dx, dy) pixels in a picture `height` pixels high.
function panCamera(camera, view, dx, dy, height) {
  const perPixel = (2 * view.distance * Math.tan(FIELD_OF_VIEW / 2)) / height;
  camera.target = add(camera.target, add(scale(view.right, -dx * perPixel), scale(view.above, dy * perPixel)));
}

function turnCamera(camera, dx, dy) {
  camera.azimuth -= dx;
  camera.elevation = clamp(camera.elevation + dy, -1.5, 1.5);
}

function zoomCamera(camera, factor) {
  camera.distance = clamp(camera.distance * factor, 0.15 * camera.start.distance, 4 * camera.start.distance);
}

// Listen on the canvas. `hooks`: camera() and viewAt(x) give what is shown now, changed() redraws, point(x, y)
// follows an idle mouse (null when it leaves), step(direction) goes to the next waypoint, reset() restores.
function attachOrbit(canvas, hooks) {
  const pointers = new Map();

  function move(event) {
    const before = pointers.get(event.pointerId), camera = hooks.camera();
    if (!before) {
      if (event.pointerType === "mouse") hooks.point(event.offsetX, event.offsetY);
      return;
    }
    const dx = event.offsetX - before.x, dy = event.offsetY - before.y;
    if (pointers.size === 2) {
      const other = [...pointers.entries()].find(([id]) => id !== event.pointerId)[1];
      const gap = (a) => Math.hypot(a.x - other.x, a.y - other.y) || 1;
      zoomCamera(camera, gap(before) / gap({ x: event.offsetX, y: event.offsetY }));
      panCamera(camera, hooks.viewAt(before.x), dx / 2, dy / 2, canvas.clientHeight);
    } else if (event.shiftKey || before.button > 0) {
      panCamera(camera, hooks.viewAt(before.x), dx, dy, canvas.clientHeight);
    } else {
      turnCamera(camera, 0.008 * dx, 0.008 * dy);
    }
    [before.x, before.y] = [event.offsetX, event.offsetY];
    before.travel += Math.abs(dx) + Math.abs(dy);
    hooks.changed();
  }

  function release(event) {
    const pointer = pointers.get(event.pointerId);
    pointers.delete(event.pointerId);
    // A tap takes the place of hovering on a touch screen.
    if (pointer && event.type === "pointerup" && pointer.travel < 6) hooks.point(event.offsetX, event.offsetY);
  }

  function key(event) {
    const camera = hooks.camera(), arrows = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    const arrow = arrows[event.key];
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (arrow && event.shiftKey) panCamera(camera, hooks.viewAt(0), 20 * arrow[0], 20 * arrow[1], canvas.clientHeight);
    else if (arrow) turnCamera(camera, 0.1 * arrow[0], 0.1 * arrow[1]);
    else if (event.key === "+" || event.key === "=") zoomCamera(camera, 0.9);
    else if (event.key === "-") zoomCamera(camera, 1.1);
    else if (event.key === "Home") hooks.reset();
    else if (event.key === "n" || event.key === "p") hooks.step(event.key === "n" ? 1 : -1);
    else if (event.key === "Escape") hooks.point(null);
    else return;
    event.preventDefault();
    hooks.changed();
  }

  canvas.addEventListener("pointerdown", (event) => {
    canvas.focus({ preventScroll: true });
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, { x: event.offsetX, y: event.offsetY, button: event.button, travel: 0 });
  });
  canvas.addEventListener("pointermove", move);
  canvas.addEventListener("pointerup", release);
  canvas.addEventListener("pointercancel", release);
  canvas.addEventListener("pointerleave", (event) => event.pointerType === "mouse" && hooks.point(null));
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("keydown", key);
  canvas.addEventListener("wheel", (event) => {
    // Only after a click: the mouse wheel otherwise scrolls the page past the picture.
    if (document.activeElement !== canvas) return;
    event.preventDefault();
    zoomCamera(hooks.camera(), Math.exp(clamp(event.deltaY, -200, 200) * 0.0015));
    hooks.changed();
  }, { passive: false });
}
