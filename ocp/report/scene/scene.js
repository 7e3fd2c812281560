// A small WebGL renderer: triangles and lines, one light that follows the camera, values coloured by a colour map.
// Values are stored multiplied by their mask, so that the border of a ground area shows the nearest true value.

const VERTEX_SHADER = `
attribute vec3 position;
attribute vec3 normal;
attribute vec2 value;
uniform mat4 model;
uniform mat4 viewProjection;
varying vec3 vNormal;
varying vec3 vPlace;
varying vec2 vValue;
void main() {
  vec4 place = model * vec4(position, 1.0);
  vPlace = place.xyz;
  vNormal = (model * vec4(normal, 0.0)).xyz;
  vValue = value;
  gl_Position = viewProjection * place;
}`;

const FRAGMENT_SHADER = `
precision highp float;
uniform sampler2D colours;
uniform vec3 colour;
uniform vec2 range;
uniform float painted;
uniform float lit;
uniform float opacity;
uniform vec3 eye;
uniform vec3 light;
varying vec3 vNormal;
varying vec3 vPlace;
varying vec2 vValue;
void main() {
  vec3 base = colour;
  float depth = 0.5;
  if (painted > 0.5 && vValue.y > 0.5) {
    float share = clamp((vValue.x / vValue.y - range.x) / (range.y - range.x), 0.0, 1.0);
    base = texture2D(colours, vec2(share * 255.0 / 256.0 + 0.5 / 256.0, 0.5)).rgb;
    depth = 0.28;  // little shading: the colour has to stay readable against the legend
  }
  vec3 n = normalize(vNormal);
  if (dot(n, eye - vPlace) < 0.0) n = -n;
  float shade = 1.0 - depth + depth * max(dot(n, light), 0.0);
  gl_FragColor = vec4(base * mix(1.0, shade, lit), opacity);
}`;

const BACKGROUND = [0.961, 0.969, 0.976];

const rgb = (hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16) / 255);

// Colours of the map at 256 even steps as RGBA bytes.
function colourBytes(hexes) {
  const stops = hexes.map(rgb), bytes = new Uint8Array(1024);
  for (let i = 0; i < 256; i++) {
    const at = (i / 255) * (stops.length - 1), k = Math.min(Math.floor(at), stops.length - 2);
    for (let c = 0; c < 3; c++) bytes[4 * i + c] = Math.round(255 * (stops[k][c] * (k + 1 - at) + stops[k + 1][c] * (at - k)));
    bytes[4 * i + 3] = 255;
  }
  return bytes;
}

function compile(gl) {
  const program = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX_SHADER], [gl.FRAGMENT_SHADER, FRAGMENT_SHADER]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  ["position", "normal", "value"].forEach((name, i) => gl.bindAttribLocation(program, i, name));
  gl.linkProgram(program);
  return gl.getProgramParameter(program, gl.LINK_STATUS) ? program : null;
}

// The renderer of a canvas, or null where WebGL is missing.
function createRenderer(canvas, hexes) {
  // The drawing is kept so that printing the page prints it.
  const gl = canvas.getContext("webgl", { antialias: true, alpha: false, preserveDrawingBuffer: true });
  const program = gl && compile(gl);
  if (!program) return null;
  const at = {};
  for (const name of ["model", "viewProjection", "colours", "colour", "range", "painted", "lit", "opacity", "eye", "light"]) {
    at[name] = gl.getUniformLocation(program, name);
  }
  gl.useProgram(program);
  gl.enable(gl.DEPTH_TEST);
  gl.enable(gl.SCISSOR_TEST);
  gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 256, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, colourBytes(hexes));
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
  for (const side of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, side, gl.CLAMP_TO_EDGE);
  gl.uniform1i(at.colours, 0);
  gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);

  function upload(array) {
    const buffer = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, array, gl.STATIC_DRAW);
    return buffer;
  }

  // A shape of mesh.js on the graphics card; without a normal it is drawn as lines.
  function mesh(shape) {
    const count = shape.position.length / 3;
    return {
      count,
      source: shape.source || null,
      mode: shape.normal ? gl.TRIANGLES : gl.LINES,
      position: upload(shape.position),
      normal: shape.normal ? upload(shape.normal) : null,
      value: null,
    };
  }

  // Values (value times mask, mask) per corner of a mesh.
  function paint(target, pairs) {
    if (target.value) gl.deleteBuffer(target.value);
    target.value = upload(pairs);
  }

  function bind(slot, buffer, size) {
    if (!buffer) {
      gl.disableVertexAttribArray(slot);
      gl.vertexAttrib3f(slot, 0, 0, 0);
      return;
    }
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.enableVertexAttribArray(slot);
    gl.vertexAttribPointer(slot, size, gl.FLOAT, false, 0, 0);
  }

  function drawItem(item) {
    gl.uniformMatrix4fv(at.model, false, item.model || IDENTITY);
    gl.uniform3fv(at.colour, item.colour);
    gl.uniform1f(at.painted, item.range && item.mesh.value ? 1 : 0);
    gl.uniform2fv(at.range, item.range || [0, 1]);
    gl.uniform1f(at.lit, item.lit === false || item.mesh.mode === gl.LINES ? 0 : 1);
    // Something seen through is drawn last and from outside only; it does not hide what comes after it.
    const through = item.opacity !== undefined;
    gl.uniform1f(at.opacity, through ? item.opacity : 1);
    for (const feature of [gl.BLEND, gl.CULL_FACE]) (through ? gl.enable(feature) : gl.disable(feature));
    gl.depthMask(!through);
    bind(0, item.mesh.position, 3);
    bind(1, item.mesh.normal, 3);
    bind(2, item.mesh.value, 2);
    gl.drawArrays(item.mesh.mode, 0, item.mesh.count);
  }

  // Draw views: each {left, width} as shares of the canvas, viewProjection, eye, light, items.
  function draw(views) {
    const sharpness = Math.min(window.devicePixelRatio || 1, 2);
    const width = Math.round(canvas.clientWidth * sharpness), height = Math.round(canvas.clientHeight * sharpness);
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    for (const view of views) {
      const box = [Math.round(view.left * width), 0, Math.round(view.width * width), height];
      gl.viewport(...box);
      gl.scissor(...box);
      gl.depthMask(true);
      gl.clearColor(...BACKGROUND, 1);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      gl.uniformMatrix4fv(at.viewProjection, false, view.viewProjection);
      gl.uniform3fv(at.eye, view.eye);
      gl.uniform3fv(at.light, view.light);
      view.items.forEach(drawItem);
    }
  }

  return { mesh, paint, draw };
}
