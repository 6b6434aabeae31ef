// Scenes: pictures on a canvas, and the pad on which the user draws one.

/** Colour of a pixel that has not been measured, and of what lies between masks. */
export const UNLIT = [44, 56, 70];

const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

/** Paint an image, each pixel of it an [r, g, b] or a grey level 0 to 1. */
export function paint(canvas, [height, width], levels) {
  canvas.width = width;
  canvas.height = height;
  const picture = new ImageData(width, height);
  for (let i = 0; i < width * height; i++) {
    const level = levels(i);
    const rgb = typeof level === "number" ? new Array(3).fill(clamp(level, 0, 1) * 255) : level;
    picture.data.set([...rgb, 255], 4 * i);
  }
  canvas.getContext("2d").putImageData(picture, 0, 0);
}

/** Paint images of one shape side by side, a level of each place and pixel as of `paint`. */
export function tile(canvas, [height, width], count, columns, level) {
  const rows = Math.ceil(count / columns);
  const gap = Math.max(1, Math.round(width / 12));
  const size = [rows * (height + gap) - gap, columns * (width + gap) - gap];
  paint(canvas, size, (at) => {
    const [y, x] = [Math.floor(at / size[1]), at % size[1]];
    const place = Math.floor(y / (height + gap)) * columns + Math.floor(x / (width + gap));
    const [row, column] = [y % (height + gap), x % (width + gap)];
    if (place >= count || row >= height || column >= width) return UNLIT;
    return level(place, row * width + column);
  });
}

/** Show reflectances (null where nothing was measured) as a picture. */
export function show(canvas, model, values) {
  const { low, high } = model.scenes;
  paint(canvas, model.image_shape, (i) =>
    values[i] === null ? UNLIT : (values[i] - low) / (high - low),
  );
}

/** Rows and columns that a drawing covers: its middle and longer side, shares of the image. */
function box(values, [height, width], ground, ink) {
  let [top, left, bottom, right] = [height, width, -1, -1];
  values.forEach((value, i) => {
    if (Math.abs(value - ground) < 0.4 * Math.abs(ink - ground)) return;
    const [y, x] = [Math.floor(i / width), i % width];
    [top, bottom] = [Math.min(top, y), Math.max(bottom, y)];
    [left, right] = [Math.min(left, x), Math.max(right, x)];
  });
  if (bottom < 0) return null;
  return {
    y: (top + bottom + 1) / 2 / height,
    x: (left + right + 1) / 2 / width,
    side: Math.max((bottom + 1 - top) / height, (right + 1 - left) / width),
  };
}

/** Canvas to draw an image on: strokes are fine, the scene is their mean over each pixel. */
export class Pad {
  constructor(canvas, model, scenes, changed) {
    Object.assign(this, { canvas, model, changed, ink: true, stroke: null });
    [this.height, this.width] = model.image_shape;
    this.fine = Math.max(1, Math.ceil(256 / Math.max(this.height, this.width)));
    this.wide = this.width * this.fine;
    this.tall = this.height * this.fine;
    const { low, high } = model.scenes;
    const edge = scenes.flatMap((scene) => this.edge(scene)).sort((a, b) => a - b);
    this.ground = edge[Math.floor(edge.length / 2)];
    this.bright = high - this.ground > this.ground - low ? high : low;
    this.pen = { radius: (this.height > 16 ? 0.05 : 0.075) * Math.max(this.wide, this.tall) };
    const boxes = scenes.map((scene) => box(scene, model.image_shape, this.ground, this.bright));
    this.usual = boxes.filter((each) => each);
    this.cursor = { x: this.wide / 2, y: this.tall / 2 };
    this.grid = new Float32Array(this.wide * this.tall).fill(this.ground);
    this.listen();
  }

  edge(scene) {
    const found = [];
    scene.forEach((value, i) => {
      const [y, x] = [Math.floor(i / this.width), i % this.width];
      if (!y || !x || y === this.height - 1 || x === this.width - 1) found.push(value);
    });
    return found;
  }

  /** Reflectance of each pixel, in the 256 levels of a camera. */
  get scene() {
    const { low, high } = this.model.scenes;
    const sums = new Float64Array(this.width * this.height);
    this.grid.forEach((value, i) => {
      const [y, x] = [Math.floor(i / this.wide), i % this.wide];
      sums[Math.floor(y / this.fine) * this.width + Math.floor(x / this.fine)] += value;
    });
    const range = high - low || 1;
    return sums.map((sum) => {
      const level = Math.round(((sum / this.fine ** 2 - low) / range) * 255);
      return low + (clamp(level, 0, 255) / 255) * range;
    });
  }

  set scene(values) {
    this.grid = this.grid.map((_, i) => {
      const [y, x] = [Math.floor(i / this.wide), i % this.wide];
      return values[Math.floor(y / this.fine) * this.width + Math.floor(x / this.fine)];
    });
  }

  clear() {
    this.grid.fill(this.ground);
    this.changed();
  }

  /** Move and scale the drawing to where test scenes have theirs. */
  fit() {
    const own = box(this.grid, [this.tall, this.wide], this.ground, this.bright);
    if (!own || !this.usual.length) return;
    const mean = (name) => this.usual.reduce((sum, each) => sum + each[name], 0) / this.usual.length;
    const scale = own.side / mean("side");
    this.grid = this.grid.map((_, i) => {
      const y = Math.round((own.y - mean("y") * scale) * this.tall + Math.floor(i / this.wide) * scale);
      const x = Math.round((own.x - mean("x") * scale) * this.wide + (i % this.wide) * scale);
      const inside = y >= 0 && y < this.tall && x >= 0 && x < this.wide;
      return inside ? this.grid[y * this.wide + x] : this.ground;
    });
    this.changed();
  }

  /** Draw a line of the pen's width between two points of the fine grid. */
  line(from, to) {
    const { radius } = this.pen;
    const level = this.ink ? this.bright : this.ground;
    const [dx, dy] = [to.x - from.x, to.y - from.y];
    const length = dx * dx + dy * dy || 1;
    const rows = [Math.min(from.y, to.y) - radius - 1, Math.max(from.y, to.y) + radius + 1];
    const columns = [Math.min(from.x, to.x) - radius - 1, Math.max(from.x, to.x) + radius + 1];
    for (let y = Math.max(0, Math.floor(rows[0])); y <= Math.min(this.tall - 1, rows[1]); y++) {
      for (let x = Math.max(0, Math.floor(columns[0])); x <= Math.min(this.wide - 1, columns[1]); x++) {
        const along = clamp(((x - from.x) * dx + (y - from.y) * dy) / length, 0, 1);
        const far = Math.hypot(x - from.x - along * dx, y - from.y - along * dy);
        const cover = clamp(radius + 0.5 - far, 0, 1);
        const place = y * this.wide + x;
        const darker = this.bright < this.ground !== !this.ink;
        const mixed = this.grid[place] + (level - this.grid[place]) * cover;
        this.grid[place] = darker ? Math.min(this.grid[place], mixed) : Math.max(this.grid[place], mixed);
      }
    }
    this.changed();
  }

  point(event) {
    const frame = this.canvas.getBoundingClientRect();
    const x = ((event.clientX - frame.left) / frame.width) * this.wide;
    return { x, y: ((event.clientY - frame.top) / frame.height) * this.tall };
  }

  listen() {
    const { canvas } = this;
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      this.stroke = this.point(event);
      this.line(this.stroke, this.stroke);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!this.stroke) return;
      const next = this.point(event);
      this.line(this.stroke, next);
      this.stroke = next;
    });
    for (const end of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(end, () => (this.stroke = null));
    }
    canvas.addEventListener("keydown", (event) => this.press(event));
  }

  press(event) {
    const moves = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    const move = moves[event.key];
    if (!move && event.key !== " ") return;
    event.preventDefault();
    const before = { ...this.cursor };
    if (move) {
      const step = Math.max(this.fine, this.wide / 32);
      this.cursor.x = clamp(this.cursor.x + move[0] * step, 0, this.wide);
      this.cursor.y = clamp(this.cursor.y + move[1] * step, 0, this.tall);
    }
    if (!move || event.shiftKey) this.line(before, this.cursor);
    else this.changed();
  }

  /** Show the scene as the camera sees it; with the keyboard's cursor where that draws. */
  draw(scene) {
    show(this.canvas, this.model, scene);
    if (!this.canvas.matches(":focus-visible")) return;
    const context = this.canvas.getContext("2d");
    const [x, y] = [this.cursor.x / this.fine, this.cursor.y / this.fine];
    context.fillStyle = "#e8590c";
    context.fillRect(clamp(Math.floor(x), 0, this.width - 1), clamp(Math.floor(y), 0, this.height - 1), 1, 1);
  }
}
