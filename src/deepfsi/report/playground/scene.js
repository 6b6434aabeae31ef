// Scenes: pictures on a canvas, and the pad on which the user draws one.

/** Colour between masks. */
const UNLIT = [44, 56, 70];

/** Paint an image, each pixel of it an [r, g, b] or a grey level 0 to 1. */
export function paint(canvas, [height, width], levels) {
  canvas.width = width;
  canvas.height = height;
  const picture = new ImageData(width, height);
  for (let i = 0; i < width * height; i++) {
    const level = levels(i);
    const rgb = typeof level === "number" ? new Array(3).fill(Math.min(Math.max(level, 0), 1) * 255) : level;
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

/** Show reflectances as a picture. */
export function show(canvas, model, values) {
  const { low, high } = model.scenes;
  paint(canvas, model.image_shape, (i) => (values[i] - low) / (high - low));
}

/** Canvas to draw an image on, pixel by pixel; the edges of a stroke are smooth. */
export class Pad {
  constructor(canvas, model, scenes, changed) {
    Object.assign(this, { canvas, model, changed, stroke: null });
    [this.height, this.width] = model.image_shape;
    const { low, high } = model.scenes;
    const edge = scenes.flatMap((scene) => [...scene.slice(0, this.width)]).sort((a, b) => a - b);
    const level = Math.round((255 * (edge[Math.floor(edge.length / 2)] - low)) / (high - low || 1));
    this.ground = `rgb(${level} ${level} ${level})`;
    const sheet = Object.assign(document.createElement("canvas"), { width: this.width, height: this.height });
    this.ink = sheet.getContext("2d", { willReadFrequently: true });
    const lineWidth = (this.height > 16 ? 0.1 : 0.15) * Math.max(this.width, this.height);
    Object.assign(this.ink, { lineCap: "round", lineWidth, strokeStyle: level < 128 ? "white" : "black" });
    this.listen();
  }

  /** Reflectance of each pixel, in the 256 levels of a camera. */
  get scene() {
    const { low, high } = this.model.scenes;
    const { data } = this.ink.getImageData(0, 0, this.width, this.height);
    return Float64Array.from({ length: data.length / 4 }, (_, i) => low + (data[4 * i] / 255) * (high - low));
  }

  set scene(values) {
    show(this.canvas, this.model, values);
    this.ink.drawImage(this.canvas, 0, 0);
  }

  clear() {
    this.ink.fillStyle = this.ground;
    this.ink.fillRect(0, 0, this.width, this.height);
    this.changed();
  }

  line(from, to) {
    this.ink.beginPath();
    this.ink.moveTo(from.x, from.y);
    this.ink.lineTo(to.x, to.y);
    this.ink.stroke();
    this.changed();
  }

  point(event) {
    const frame = this.canvas.getBoundingClientRect();
    const x = ((event.clientX - frame.left) / frame.width) * this.width;
    return { x, y: ((event.clientY - frame.top) / frame.height) * this.height };
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
  }
}
