// Draws triangles with individual colours, lines and translucent boxes with WebGL2. A texture contains the
// colours, so another set of triangles costs one upload.

const WIDTH = 2048;
// The values of the texture's fourth number: the triangle is not drawn, or drawn.
const SKIP = 0, DRAW = 255;

const SOLID = `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
layout(location = 0) in vec3 at;
uniform mat4 view;
uniform sampler2D colours;
out vec3 place;
flat out vec3 colour;
flat out int id;
void main() {
  id = gl_VertexID / 3;
  vec4 texel = texelFetch(colours, ivec2(id % ${WIDTH}, id / ${WIDTH}), 0);
  colour = texel.rgb;
  place = at;
  gl_Position = texel.a < 0.5 ? vec4(0.0, 0.0, 2.0, 1.0) : view * vec4(at, 1.0);
}`;
const SHADE = `#version 300 es
precision highp float;
precision highp int;
in vec3 place;
flat in vec3 colour;
uniform vec3 eye;
out vec4 pixel;
void main() {
  vec3 normal = normalize(cross(dFdx(place), dFdy(place)));
  // Faces across different axes differ, so that corners show.
  float side = dot(normal * normal, vec3(0.62, 0.92, 0.78));
  float facing = abs(dot(normal, normalize(eye - place)));
  pixel = vec4(colour * (0.9 * side + 0.1 * facing), 1.0);
}`;
const NUMBER = `#version 300 es
precision highp float;
precision highp int;
flat in int id;
out vec4 pixel;
void main() {
  int n = id + 1;
  pixel = vec4(ivec4(n & 255, n >> 8 & 255, n >> 16 & 255, n >> 24 & 255)) / 255.0;
}`;
const PLAIN = `#version 300 es
layout(location = 0) in vec3 at;
layout(location = 1) in vec4 tint;
uniform mat4 view;
out vec4 colour;
void main() { colour = tint; gl_Position = view * vec4(at, 1.0); }`;
const TINT = `#version 300 es
precision highp float;
in vec4 colour;
out vec4 pixel;
void main() { pixel = colour; }`;

export class Renderer {
  constructor(canvas, positions) {
    const gl = canvas.getContext('webgl2', { antialias: true, preserveDrawingBuffer: true });
    if (!gl) throw new Error('This browser has no WebGL2, which draws the scene. Use a current Chromium, Firefox or Safari.');
    this.gl = gl;
    this.canvas = canvas;
    this.triangles = positions.length / 9;
    const rows = Math.max(1, Math.ceil(this.triangles / WIDTH));
    if (rows > gl.getParameter(gl.MAX_TEXTURE_SIZE)) throw new Error('This browser cannot draw so many triangles.');
    this.solid = this.#program(SOLID, SHADE);
    this.number = this.#program(SOLID, NUMBER);
    this.plain = this.#program(PLAIN, TINT);
    this.scene = gl.createVertexArray();
    gl.bindVertexArray(this.scene);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, positions, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
    this.texels = new Uint8Array(4 * WIDTH * rows);
    this.rows = rows;
    this.colours = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.colours);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA8, WIDTH, rows);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
    this.layers = { lines: this.#layer(), cells: this.#layer(), boxes: this.#layer() };
    this.pick = this.#target();
    gl.enable(gl.DEPTH_TEST);
  }

  #program(vertex, fragment) {
    const { gl } = this, program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    const of = (name) => gl.getUniformLocation(program, name);
    return { program, view: of('view'), eye: of('eye') };
  }

  // Creates a layer of points with colours, seven numbers each.
  #layer() {
    const { gl } = this, array = gl.createVertexArray(), buffer = gl.createBuffer();
    gl.bindVertexArray(array);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.enableVertexAttribArray(0);
    gl.enableVertexAttribArray(1);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 28, 0);
    gl.vertexAttribPointer(1, 4, gl.FLOAT, false, 28, 12);
    return { array, buffer, points: 0 };
  }

  #fill(layer, numbers) {
    const { gl } = this;
    gl.bindBuffer(gl.ARRAY_BUFFER, layer.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(numbers), gl.DYNAMIC_DRAW);
    layer.points = numbers.length / 7;
  }

  #target() {
    const { gl } = this, frame = gl.createFramebuffer();
    return { frame, colour: gl.createRenderbuffer(), depth: gl.createRenderbuffer(), size: [0, 0] };
  }

  // Sets the colour of every triangle. `of(id)` returns 0xrrggbb, or -1 to skip the triangle. Returns the
  // number of drawn triangles.
  colour(of) {
    const { gl, texels } = this;
    let drawn = 0;
    for (let id = 0, o = 0; id < this.triangles; id++, o += 4) {
      const c = of(id);
      texels[o + 3] = c < 0 ? SKIP : DRAW;
      if (c < 0) continue;
      drawn++;
      texels[o] = c >> 16;
      texels[o + 1] = c >> 8 & 255;
      texels[o + 2] = c & 255;
    }
    gl.bindTexture(gl.TEXTURE_2D, this.colours);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, WIDTH, this.rows, gl.RGBA, gl.UNSIGNED_BYTE, texels);
    return drawn;
  }

  // Sets the lines as [from, to, [r, g, b, a]]. The lines of cells are a separate layer, because they change
  // less often.
  lines(all, layer = 'lines') { this.#fill(this.layers[layer], all.flatMap(([p, q, c]) => [...p, ...c, ...q, ...c])); }

  // Sets translucent boxes as [lowest and highest corner in six numbers, [r, g, b, a]].
  boxes(all) {
    const corner = (b, k) => [b[k & 1 ? 3 : 0], b[k & 2 ? 4 : 1], b[k & 4 ? 5 : 2]];
    const faces = [0, 1, 3, 0, 3, 2, 4, 5, 7, 4, 7, 6, 0, 1, 5, 0, 5, 4, 2, 3, 7, 2, 7, 6, 0, 2, 6, 0, 6, 4, 1, 3, 7, 1, 7, 5];
    this.#fill(this.layers.boxes, all.flatMap(([b, c]) => faces.flatMap((k) => [...corner(b, k), ...c])));
  }

  resize() {
    const { canvas, gl } = this, ratio = Math.min(2, window.devicePixelRatio || 1);
    const [w, h] = [Math.max(1, canvas.clientWidth * ratio | 0), Math.max(1, canvas.clientHeight * ratio | 0)];
    if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
    gl.viewport(0, 0, w, h);
    return w / h;
  }

  #solid(program, view, eye) {
    const { gl } = this;
    gl.useProgram(program.program);
    gl.uniformMatrix4fv(program.view, false, view);
    if (program.eye) gl.uniform3fv(program.eye, eye);
    gl.bindVertexArray(this.scene);
    gl.bindTexture(gl.TEXTURE_2D, this.colours);
    gl.drawArrays(gl.TRIANGLES, 0, 3 * this.triangles);
  }

  draw(view, eye) {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.clearColor(0.075, 0.085, 0.1, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    this.#solid(this.solid, view, eye);
    gl.useProgram(this.plain.program);
    gl.uniformMatrix4fv(this.plain.view, false, view);
    const { lines, cells, boxes } = this.layers;
    for (const layer of [lines, cells]) {
      gl.bindVertexArray(layer.array);
      gl.drawArrays(gl.LINES, 0, layer.points);
    }
    if (!boxes.points) return;
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    gl.depthMask(false);
    gl.bindVertexArray(boxes.array);
    gl.drawArrays(gl.TRIANGLES, 0, boxes.points);
    gl.depthMask(true);
    gl.disable(gl.BLEND);
  }

  // Returns the triangle at a position of the canvas in CSS pixels, or -1 if there is no triangle.
  at(x, y, view, eye) {
    const { gl, canvas, pick } = this, ratio = canvas.width / canvas.clientWidth;
    gl.bindFramebuffer(gl.FRAMEBUFFER, pick.frame);
    if (pick.size[0] !== canvas.width || pick.size[1] !== canvas.height) {
      pick.size = [canvas.width, canvas.height];
      for (const [buffer, format, place] of [[pick.colour, gl.RGBA8, gl.COLOR_ATTACHMENT0],
        [pick.depth, gl.DEPTH_COMPONENT24, gl.DEPTH_ATTACHMENT]]) {
        gl.bindRenderbuffer(gl.RENDERBUFFER, buffer);
        gl.renderbufferStorage(gl.RENDERBUFFER, format, canvas.width, canvas.height);
        gl.framebufferRenderbuffer(gl.FRAMEBUFFER, place, gl.RENDERBUFFER, buffer);
      }
    }
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    this.#solid(this.number, view, eye);
    const p = new Uint8Array(4);
    gl.readPixels(x * ratio | 0, canvas.height - 1 - (y * ratio | 0), 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, p);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    return (p[0] | p[1] << 8 | p[2] << 16 | p[3] << 24) - 1;
  }
}
