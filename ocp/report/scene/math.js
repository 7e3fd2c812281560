// Vectors of three and 4 x 4 matrices in column order (as WebGL wants them), only what the viewer needs.

const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const scale = (a, k) => [a[0] * k, a[1] * k, a[2] * k];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const norm = (a) => Math.sqrt(dot(a, a));
const unit = (a) => scale(a, 1 / (norm(a) || 1));
const clamp = (x, low, high) => Math.min(Math.max(x, low), high);

const IDENTITY = new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);

function multiply(A, B) {
  const C = new Float32Array(16);
  for (let j = 0; j < 4; j++) {
    for (let i = 0; i < 4; i++) {
      let sum = 0;
      for (let k = 0; k < 4; k++) sum += A[4 * k + i] * B[4 * j + k];
      C[4 * j + i] = sum;
    }
  }
  return C;
}

// Columns x, y, z and origin p of a frame as a matrix.
function frame(x, y, z, p) {
  return new Float32Array([x[0], x[1], x[2], 0, y[0], y[1], y[2], 0, z[0], z[1], z[2], 0, p[0], p[1], p[2], 1]);
}

function movePoint(M, p) {
  return [0, 1, 2].map((i) => M[i] * p[0] + M[4 + i] * p[1] + M[8 + i] * p[2] + M[12 + i]);
}

function moveDirection(M, v) {
  return [0, 1, 2].map((i) => M[i] * v[0] + M[4 + i] * v[1] + M[8 + i] * v[2]);
}

// Inverse of a rotation with a translation.
function invertRigid(M) {
  const x = [M[0], M[4], M[8]], y = [M[1], M[5], M[9]], z = [M[2], M[6], M[10]], p = [M[12], M[13], M[14]];
  return frame(x, y, z, [0, 1, 2].map((i) => -(M[4 * i] * p[0] + M[4 * i + 1] * p[1] + M[4 * i + 2] * p[2])));
}

// Camera that stands at `eye`, looks at `target`, with `up` upward in the picture.
function lookAt(eye, target, up) {
  const z = unit(sub(eye, target)), x = unit(cross(up, z)), y = cross(z, x);
  return invertRigid(frame(x, y, z, eye));
}

function perspective(fieldOfView, aspect, near, far) {
  const f = 1 / Math.tan(fieldOfView / 2), d = 1 / (near - far);
  return new Float32Array([f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) * d, -1, 0, 0, 2 * far * near * d, 0]);
}

// Pose between two 3 x 4 row-order poses at `a` and `b` of `data`: axes and origin mixed, axes made orthogonal again.
function blendPose(data, a, b, share) {
  const at = (i) => data[a + i] * (1 - share) + data[b + i] * share;
  const x = unit([at(0), at(4), at(8)]);
  const mixed = [at(1), at(5), at(9)];
  const y = unit(sub(mixed, scale(x, dot(x, mixed))));
  return frame(x, y, cross(x, y), [at(3), at(7), at(11)]);
}

// Where a world point falls: x, y in -1..1 and depth w (positive in front of the camera).
function project(viewProjection, p) {
  const M = viewProjection, w = M[3] * p[0] + M[7] * p[1] + M[11] * p[2] + M[15];
  return [
    (M[0] * p[0] + M[4] * p[1] + M[8] * p[2] + M[12]) / w,
    (M[1] * p[0] + M[5] * p[1] + M[9] * p[2] + M[13]) / w,
    w,
  ];
}
