// Shapes as plain arrays: {position, normal, source}. `source` says per corner where its value comes from.

// Numbers of an encoded array: base64 of little-endian values (payload.py).
function decode(packed) {
  const text = atob(packed.data), bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  const kinds = { "<f4": Float32Array, "<u4": Uint32Array, "<u2": Uint16Array, "<u1": Uint8Array };
  return new kinds[packed.dtype](bytes.buffer);
}

// Blade triangles with a corner each, shaded smooth except over edges sharper than about 37 degrees.
function bladeMesh(vertices, faces) {
  const count = faces.length / 3, faceNormal = new Float32Array(3 * count), around = [];
  const at = (v) => [vertices[3 * v], vertices[3 * v + 1], vertices[3 * v + 2]];
  for (let f = 0; f < count; f++) {
    const [a, b, c] = [0, 1, 2].map((k) => at(faces[3 * f + k]));
    faceNormal.set(cross(sub(b, a), sub(c, a)), 3 * f);
    for (let k = 0; k < 3; k++) (around[faces[3 * f + k]] ||= []).push(f);
  }
  const position = new Float32Array(9 * count), normal = new Float32Array(9 * count);
  for (let f = 0; f < count; f++) {
    const own = unit(faceNormal.subarray(3 * f, 3 * f + 3));
    for (let k = 0; k < 3; k++) {
      const vertex = faces[3 * f + k];
      let sum = [0, 0, 0];
      for (const g of around[vertex]) {
        const other = faceNormal.subarray(3 * g, 3 * g + 3);
        if (dot(own, other) > 0.8 * norm(other)) sum = add(sum, other);
      }
      position.set(at(vertex), 9 * f + 3 * k);
      normal.set(norm(sum) > 0 ? unit(sum) : own, 9 * f + 3 * k);
    }
  }
  return { position, normal, source: faces };
}

// Pass lines as narrow strips lying `lift` above the surface; source is the waypoint.
function ribbons(passes, width, lift) {
  const position = [], normal = [], source = [];
  for (let j = 0; j + 1 < passes.first.length; j++) {
    let before = null;
    for (let i = passes.first[j]; i < passes.first[j + 1]; i++) {
      const n = passes.n.subarray(3 * i, 3 * i + 3), side = scale(cross(n, passes.t.subarray(3 * i, 3 * i + 3)), width / 2);
      const middle = add(passes.p.subarray(3 * i, 3 * i + 3), scale(n, lift));
      const now = { left: add(middle, side), right: sub(middle, side), n, i };
      if (before) {
        for (const [end, edge] of [[before, "right"], [now, "right"], [now, "left"], [before, "right"], [now, "left"], [before, "left"]]) {
          position.push(...end[edge]);
          normal.push(...end.n);
          source.push(end.i);
        }
      }
      before = now;
    }
  }
  return { position: new Float32Array(position), normal: new Float32Array(normal), source };
}

// Body of revolution about the line from p0 to p1: rings of [distance along in m, radius, normal along, normal out].
function revolve(p0, p1, rings, segments) {
  const along = unit(sub(p1, p0)), x = unit(cross(along, Math.abs(along[0]) < 0.8 ? [1, 0, 0] : [0, 1, 0])), y = cross(along, x);
  const position = [], normal = [];
  const corner = (ring, k) => {
    const angle = (2 * Math.PI * k) / segments, out = add(scale(x, Math.cos(angle)), scale(y, Math.sin(angle)));
    position.push(...add(p0, add(scale(along, ring[0]), scale(out, ring[1]))));
    normal.push(...add(scale(along, ring[2]), scale(out, ring[3])));
  };
  for (let r = 0; r + 1 < rings.length; r++) {
    for (let k = 0; k < segments; k++) {
      const [a, b] = [rings[r], rings[r + 1]];
      corner(a, k); corner(a, k + 1); corner(b, k + 1);
      corner(a, k); corner(b, k + 1); corner(b, k);
    }
  }
  return { position: new Float32Array(position), normal: new Float32Array(normal), source: null };
}

function capsuleMesh(p0, p1, radius) {
  const length = norm(sub(p1, p0)), rings = [], steps = 8;
  for (let i = 0; i <= steps; i++) {
    const a = ((i / steps - 1) * Math.PI) / 2;
    rings.push([radius * Math.sin(a), radius * Math.cos(a), Math.sin(a), Math.cos(a)]);
  }
  for (let i = 0; i <= steps; i++) {
    const a = ((i / steps) * Math.PI) / 2;
    rings.push([length + radius * Math.sin(a), radius * Math.cos(a), Math.sin(a), Math.cos(a)]);
  }
  // A capsule of no length is a sphere; any direction serves as its axis.
  return revolve(p0, length > 1e-9 ? p1 : add(p0, [0, 0, 1]), rings, 48);
}

function cylinderMesh(centre, axis, radius, width) {
  const h = width / 2, p0 = sub(centre, scale(axis, h));
  const rings = [[0, 0, -1, 0], [0, radius, -1, 0], [0, radius, 0, 1], [width, radius, 0, 1], [width, radius, 1, 0], [width, 0, 1, 0]];
  return revolve(p0, add(centre, scale(axis, h)), rings, 120);
}

// Lines of a floor grid at height zero, every `step` m around (x, y).
function gridLines(x, y, half, step) {
  const position = [];
  for (let d = -half; d <= half + 1e-9; d += step) {
    position.push(x + d, y - half, 0, x + d, y + half, 0, x - half, y + d, 0, x + half, y + d, 0);
  }
  return new Float32Array(position);
}
