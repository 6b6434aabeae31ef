// The page: what the user does, and what is shown of it.

import {
  accuracyAt,
  chanceText,
  drawAnswer,
  drawCounts,
  drawCurve,
  drawDwells,
  drawHistory,
  photonsText,
  places,
} from "./charts.js";
import { Exposure, LeastSquares, Rivals } from "./exposure.js";
import { Model } from "./model.js";
import { poisson, Random, unpack } from "./numbers.js";
import { colour, CurvePad, ImagePad, paint, plot, show } from "./scene.js";

const SHORTEST = 6; // seconds of a whole exposure on the page at speed 1
const LONGEST = 14;
const MOST_ROWS = 400; // of a least-squares picture that is renewed during an exposure
const MOSAIC = 64; // masks shown side by side
const CURVES = ["--pca", "--deepfsi", "--truncated-hadamard", "--control", "--hadamard", "--muted"];

const $ = (id) => document.getElementById(id);
const PLACES = [1, 2, 4, 6, 8, 10];

/** Smallest round number that is not below a value. */
function roundUp(value) {
  const unit = 10 ** Math.floor(Math.log10(value));
  return PLACES.find((place) => place * unit >= value) * unit;
}

const percent = (share) => `${(share * 100).toFixed(share < 0.1 ? 1 : 0)} %`;

class Page {
  constructor(model, scenes) {
    Object.assign(this, { model, scenes, label: null, playing: false, drawn: {} });
    this.spectrum = model.image_shape.length === 1;
    this.squares = new LeastSquares(model);
    const Pad = this.spectrum ? CurvePad : ImagePad;
    this.pad = new Pad($("scene"), model, scenes, () => this.drew());
    const { low, high } = model.budget ?? { low: 1e4, high: 1e4 };
    $("light").value = Math.min(Math.max(Math.log10(Math.sqrt(low * high)), 1), 7);
    $("seed").value = 1;
    $("mask").parentElement.classList.toggle("curves", this.spectrum);
    this.listThumbs();
    this.listen();
    this.choose(Math.floor(scenes.length / 3));
  }

  get photons() {
    return 10 ** Number($("light").value);
  }

  get seed() {
    const given = Math.floor(Number($("seed").value));
    return Number.isFinite(given) ? Math.min(Math.max(given, 0), 2 ** 32 - 1) : 0;
  }

  listThumbs() {
    $("scenes").classList.toggle("curves", this.spectrum);
    this.thumbs = this.scenes.map((scene, place) => {
      const button = document.createElement("button");
      button.type = "button";
      const name = this.model.classes[this.model.scenes.labels[place]];
      button.setAttribute("aria-label", `Test scene ${place + 1}, class ${name}`);
      button.title = name;
      const canvas = document.createElement("canvas");
      if (this.spectrum) plot(canvas, [{ values: scene, ink: colour("--ink") }], [this.model.scenes.low, this.model.scenes.high], [120, 56]);
      else show(canvas, this.model, scene);
      button.append(canvas);
      button.addEventListener("click", () => this.choose(place));
      return button;
    });
    $("scenes").replaceChildren(...this.thumbs);
  }

  choose(place) {
    this.label = this.model.scenes.labels[place];
    this.chosen = place;
    this.pad.scene = this.scenes[place];
    this.scene = Float64Array.from(this.scenes[place]);
    this.renew();
  }

  /** The user has drawn: the scene is his own. */
  drew() {
    const scene = this.pad.scene;
    const same = this.scene && scene.every((value, i) => Math.abs(value - this.scene[i]) < 1e-12);
    if (!same) {
      this.label = this.chosen = null;
      this.scene = scene;
    }
    this.pad.draw(this.scene);
    if (same || this.waiting) return;
    this.waiting = requestAnimationFrame(() => {
      this.waiting = null;
      this.renew();
    });
  }

  /** Expose anew, and show the end of the exposure. */
  renew() {
    this.pause();
    const { model, scene, photons, seed } = this;
    this.exposure = new Exposure(model, scene, photons, seed);
    this.rivals = new Rivals(model, scene, photons, seed);
    const { counts } = this.exposure.after(this.exposure.frames.length);
    this.most = roundUp(Math.max(...this.byMask(counts).flat(), 4));
    this.time = this.exposure.length;
    this.drawn = {};
    this.pad.draw(scene);
    this.thumbs.forEach((thumb, place) => thumb.setAttribute("aria-pressed", place === this.chosen));
    show($("truth"), model, scene);
    this.sayLight();
    this.draw();
  }

  sayLight() {
    const { model, photons } = this;
    drawCurve($("curve"), model, photons);
    $("photons").textContent = `${photonsText(photons)} photons`;
    $("light").setAttribute("aria-valuetext", $("photons").textContent);
    const share = accuracyAt(model.curve, photons);
    const brightness = this.scene.reduce((a, b) => a + b, 0) / model.summed_reflectance;
    const counted = model.rates(this.scene).reduce((a, b) => a + b, 0) * photons;
    $("light-words").textContent =
      `About ${percent(share)} of the test scenes are right with so much light. ` +
      `From this scene come ${photonsText(photons * brightness)} photons, ` +
      `${photonsText((photons * brightness) / model.pixels)} per ${this.spectrum ? "band" : "pixel"}` +
      (model.chooser ? "." : `; the detectors count about ${photonsText(counted)} of them.`);
    const name = this.label === null ? null : model.classes[this.label];
    $("scene-words").textContent = name === null ? "Your own scene." : `Test scene of class ${name}.`;
  }

  /** Counts [rail][mask] of all detectors together. */
  byMask(counts) {
    const { model } = this;
    return model.peaks.map((_, rail) =>
      Array.from({ length: model.masks }, (_, mask) => {
        let sum = 0;
        for (let d = 0; d < model.detectors; d++) sum += counts[model.place(rail, mask, d)];
        return sum;
      }),
    );
  }

  /** Draw the moment `time`; what has not changed since it was last drawn stays. */
  draw() {
    const { exposure, model, drawn } = this;
    const { frames } = exposure;
    let count = frames.findIndex((frame) => frame.end > this.time + 1e-12);
    if (count < 0) count = frames.length;
    const now = frames[count] ?? null;
    const part = now ? (this.time - now.begin) / now.share : 0;
    const whole = exposure.after(count); // without the part of the frame that is on the device
    const counts = whole.counts.slice();
    if (now) now.places.forEach((place, i) => (counts[place] += Math.floor(now.counts[i] * part)));
    const shown = this.time > 0 ? now : frames[0];
    drawCounts($("counts"), model, this.byMask(counts), this.most, now && now.mask);
    const total = counts.reduce((a, b) => a + b, 0);
    $("count-words").textContent = `${total.toLocaleString("en").replaceAll(",", "\u202f")} photons so far.`;
    const place = Math.round((this.time / exposure.length) * 1000);
    $("time").value = place;
    $("time").setAttribute("aria-valuetext", `${Math.round(place / 10)} % of the exposure`);
    $("play").textContent = this.playing ? "Pause" : "Play";
    this.state(count, now);
    const share = this.time / exposure.length;
    show($("raster"), model, this.rivals.rasterAt(share));
    show($("impulse"), model, this.rivals.impulseAt(share));
    if (drawn.count !== count) {
      this.drawAnswer(count);
      const few = model.readouts <= MOST_ROWS || count === frames.length;
      if (few && !(this.playing && performance.now() - (drawn.pictured ?? 0) < 150)) {
        drawn.pictured = performance.now();
        const nothing = () => null;
        const picture = count ? this.squares.picture(whole.counts, whole.scale, exposure.photons) : null;
        show($("squares"), model, picture ?? Array.from(this.scene, nothing));
      }
    }
    if (drawn.frame !== shown || drawn.count === undefined) {
      this.drawMask(shown);
      if (!exposure.together) this.drawTimes(shown);
    }
    this.drawn = { ...this.drawn, count, frame: shown };
  }

  state(count, now) {
    const { exposure, model } = this;
    const words = [`${percent(this.time / exposure.length)} of the exposure`];
    if (now && !exposure.together) {
      words.push(`frame ${count + 1} of ${exposure.frames.length}`);
      if (model.chooser) words.push(`look ${now.look + 1} of ${model.looks}`);
    }
    if (!now) words.push("finished");
    $("state").textContent = words.join(" · ");
  }

  drawAnswer(count) {
    const { exposure, model } = this;
    const { unlike } = exposure;
    if (!this.playing && !unlike) exposure.answerAll(count);
    const { chances, sound } = unlike ? { chances: null, sound: true } : exposure.answer(count);
    const top = drawAnswer($("answer"), model, chances, sound);
    drawHistory($("history"), exposure, count, top);
    $("answer-words").textContent = this.about(chances);
    $("verdict").textContent = this.verdict(count, top, chances);
  }

  about(chances) {
    const { exposure, model } = this;
    const { rule } = exposure;
    if (exposure.unlike) return "No probabilities are given for this scene.";
    const judged = rule && rule.threshold < 1
      ? ` The dashed line is the confidence above which an exposure may stop, chosen at ${photonsText(rule.photons)} photons.`
      : "";
    if (!chances) return `Nothing is counted yet.${judged}`;
    if (exposure.together) return `All masks see light at once: this is the answer to the light so far.${judged}`;
    const dots = "Filled bars and dots are answers that the network has learned to give: ";
    if (model.chooser) return `${dots}after each look. Outlined bars are between two looks.${judged}`;
    const { nested } = model.exposure;
    const when = nested ? `after mask ${nested} and each one behind it` : "after the last mask";
    return `${dots}${when}. Outlined bars take masks that were not shown yet as for a mean scene.${judged}`;
  }

  verdict(count, top, chances) {
    const { exposure, model, label } = this;
    if (count < exposure.frames.length) {
      const { stop } = exposure;
      if (!stop || count < stop.count) return "The exposure goes on.";
      return `The exposure goes on. It could have stopped ${this.stopWords(stop)}`;
    }
    if (exposure.unlike) return "No answer: this scene is darker, brighter or flatter than all that the design was learned from.";
    const name = model.classes[top];
    const right = label === null ? "" : top === label ? ", which is right" : `, which is wrong: it is ${model.classes[label]}`;
    const dim = model.tooDim(exposure.photons) ? "Too little light for this design: its answer is hardly more than a guess. " : "";
    const answer = `${dim}Answer: ${name}${right}. Probability ${chanceText(chances[top])}.`;
    const { stop, rule } = exposure;
    if (stop) return `${answer} It could have stopped ${this.stopWords(stop)}`;
    return rule && rule.threshold < 1 ? `${answer} It was never sure enough to stop earlier.` : answer;
  }

  stopWords(stop) {
    const { model } = this;
    const name = model.classes[stop.chances.indexOf(Math.max(...stop.chances))];
    const unit = model.chooser ? "look" : "mask";
    const all = model.chooser ? model.looks : model.masks;
    return `after ${unit} ${stop.at} of ${all} with the answer ${name}, and saved ${percent(stop.saved)} of the light.`;
  }

  drawTimes(frame) {
    const { exposure, model } = this;
    const look = frame ? frame.look : model.looks - 1;
    drawDwells($("dwells"), exposure, look, frame);
    if (!model.chooser) {
      $("dwell-words").textContent = "Share of the exposure; the same for every scene.";
      return;
    }
    $("h-dwells").textContent = `Time of each mask in look ${look + 1} of ${model.looks}`;
    $("dwell-words").textContent = look
      ? "Share of the exposure, chosen from the counts so far. Short lines: the look before."
      : "Share of the exposure. The first look is the same for every scene.";
  }

  drawMask(frame) {
    const { model } = this;
    const canvas = $("mask");
    $("h-device").textContent = this.exposure.together || !frame ? "Masks" : "On the device now";
    if (this.exposure.together || !frame) {
      this.drawMosaic();
      return;
    }
    this.mosaic = false;
    const { mask, rails, share } = frame;
    const [rail] = rails;
    const pattern = Array.from({ length: model.pixels }, (_, i) => model.entry(rail, mask, i));
    let peak = model.light === "equal-dwell" ? share : model.peaks[rail][mask]; // of a mirror that is always ON
    if (rails.length > 1) peak = model.entry(0, mask, 0) + model.entry(1, mask, 0);
    const device = pattern.map((each) => each / peak);
    const { high } = model.scenes;
    const passed = device.map((each, i) => each * this.scene[i]);
    if (this.spectrum) {
      plot(canvas, [{ values: device, ink: colour(rail ? "--deepfsi" : "--pca"), steps: true }], [0, 1]);
      plot($("through"), [{ values: passed, ink: colour("--ink") }], [0, high]);
    } else {
      paint(canvas, model.image_shape, (i) => device[i]);
      paint($("through"), model.image_shape, (i) => passed[i] / high);
    }
    $("through").hidden = false;
    canvas.classList.toggle("rail-minus", rail === 1);
    canvas.classList.toggle("rail-plus", rail === 0);
    const which = rails.length > 1 ? ", both arms" : model.rails === 2 ? [", positive rail", ", negative rail"][rail] : "";
    const [one, other] = this.spectrum ? ["Above", "Below"] : ["Left", "Right"];
    const arms = this.spectrum ? "High goes in one direction, low in the other. " : "White goes in one direction, black in the other. ";
    const all = this.spectrum ? "" : `White goes to the detector${model.detectors > 1 ? "s" : ""}. `;
    $("mask-words").textContent =
      `${one}: mask ${mask + 1} of ${model.masks}${which}, shown for ${percent(share / this.exposure.length)} of the exposure. ` +
      (rails.length > 1 ? arms : all) + `${other}: the light that ${rails.length > 1 ? "goes in the first direction" : "gets there"}, ${this.spectrum ? "low" : "black"} where there is little.`;
  }

  /** All masks side by side: as they are used at once, or before and after an exposure. */
  drawMosaic() {
    const { model } = this;
    if (this.mosaic) return;
    this.mosaic = true;
    const canvas = $("mask");
    const count = Math.min(model.masks, this.spectrum ? CURVES.length : MOSAIC);
    canvas.classList.remove("rail-plus", "rail-minus");
    const value = (mask, i) => model.matrix[mask * model.pixels + i];
    const peaks = Array.from({ length: count }, (_, mask) => Math.max(model.peaks[0][mask], model.peaks[1]?.[mask] ?? 0));
    if (this.spectrum) {
      const curves = places(count).map((mask) => ({
        values: Array.from({ length: model.pixels }, (_, i) => value(mask, i) / peaks[mask]),
        ink: colour(CURVES[mask]),
      }));
      plot(canvas, curves, [model.rails === 2 ? -1 : 0, 1]);
    } else {
      const [height, width] = model.image_shape;
      const columns = Math.ceil(Math.sqrt(count));
      const rows = Math.ceil(count / columns);
      const dwells = places(count).map((mask) => model.entry(0, mask, 0) + (model.rails > 1 ? model.entry(1, mask, 0) : 0));
      const gap = Math.max(1, Math.round(width / 12));
      const size = [rows * (height + gap) - gap, columns * (width + gap) - gap];
      paint(canvas, size, (at) => {
        const [y, x] = [Math.floor(at / size[1]), at % size[1]];
        const mask = Math.floor(y / (height + gap)) * columns + Math.floor(x / (width + gap));
        const [row, column] = [y % (height + gap), x % (width + gap)];
        if (mask >= count || row >= height || column >= width) return UNLIT;
        const share = value(mask, row * width + column) / peaks[mask];
        if (model.rails === 1) return share;
        if (model.light === "two-arm") return (1 + value(mask, row * width + column) / dwells[mask]) / 2;
        const bright = share > 0 ? [86, 180, 255] : [255, 125, 59];
        return bright.map((each) => each * Math.abs(share));
      });
    }
    if ($("through")) $("through").hidden = true;
    const some = count < model.masks ? `The first ${count} of ${model.masks} masks` : `All ${model.masks} masks`;
    const dual = model.light === "two-arm" ? " White goes in one direction, black in the other." : " Blue is counted by the positive rail, orange by the negative one.";
    const signs = model.rails === 2 ? dual : " White is counted, black is not.";
    $("mask-words").textContent = `${some}, each to its own brightest value.${this.spectrum ? "" : signs}`;
  }

  play() {
    if (this.time >= this.exposure.length - 1e-9) this.time = 0;
    this.playing = true;
    let before = null;
    const frames = this.exposure.frames.length;
    const seconds = Math.min(Math.max(frames * 0.3, SHORTEST), LONGEST);
    const tick = (now) => {
      if (!this.playing) return;
      const passed = before === null ? 0 : (now - before) / 1000;
      before = now;
      this.time += (passed * Number($("speed").value) * this.exposure.length) / seconds;
      if (this.time >= this.exposure.length) {
        this.time = this.exposure.length;
        this.playing = false;
        this.drawn.count = null;
      }
      this.draw();
      if (this.playing) requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  pause() {
    this.playing = false;
    if (this.exposure) $("play").textContent = "Play";
  }

  step() {
    this.pause();
    const { frames, length } = this.exposure;
    if (this.time >= length - 1e-9) this.time = 0;
    else this.time = frames.find((frame) => frame.end > this.time + 1e-9)?.end ?? length;
    this.draw();
  }

  listen() {
    const on = (id, event, act) => $(id)?.addEventListener(event, act);
    on("light", "input", () => this.renew());
    on("seed", "change", () => {
      $("seed").value = this.seed;
      this.renew();
    });
    on("expose", "click", () => {
      this.renew();
      this.time = 0;
      this.play();
    });
    on("another", "click", () => {
      $("seed").value = (this.seed + 1) % 2 ** 32;
      this.renew();
      this.time = 0;
      this.play();
    });
    on("play", "click", () => (this.playing ? (this.pause(), this.draw()) : this.play()));
    on("step", "click", () => this.step());
    on("time", "input", () => {
      this.pause();
      this.time = (Number($("time").value) / 1000) * this.exposure.length;
      this.draw();
    });
    on("clear", "click", () => this.pad.clear());
    on("fit", "click", () => this.pad.fit());
    on("invert", "click", () => this.pad.invert());
    for (const pen of document.querySelectorAll("input[name=pen]")) {
      pen.addEventListener("change", () => (this.pad.ink = pen.value === "ink"));
    }
    if (!this.spectrum) this.listenForPictures(on);
    const again = () => {
      this.mosaic = false;
      this.listThumbs();
      this.renew();
    };
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", again);
    let width = innerWidth;
    addEventListener("resize", () => {
      if (innerWidth === width) return;
      width = innerWidth;
      this.sayLight();
      this.drawn = {};
      this.draw();
    });
    on("scene", "focus", () => this.pad.draw(this.scene));
    on("scene", "blur", () => this.pad.draw(this.scene));
  }

  listenForPictures(on) {
    const side = Math.max(this.pad.wide, this.pad.tall);
    $("width").value = Math.round((this.pad.pen.radius / side) * 80 * 2) / 2;
    on("width", "input", () => (this.pad.pen.radius = (Number($("width").value) / 80) * side));
    const take = async (file) => {
      if (!file) return;
      try {
        await this.pad.take(file);
      } catch {
        $("scene-words").textContent = `${file.name} is no picture that this browser reads: give a PNG or JPEG file.`;
      }
    };
    on("picture", "click", () => $("file").click());
    on("file", "change", () => take($("file").files[0]));
    on("scene", "drop", (event) => {
      event.preventDefault();
      $("scene").classList.remove("over");
      take(event.dataTransfer.files[0]);
    });
  }
}

const UNLIT = [44, 56, 70];

async function start() {
  const payload = JSON.parse($("payload").textContent);
  const model = await Model.load(payload);
  const { shape, values } = await unpack(payload.scenes.levels);
  const { low, high } = payload.scenes;
  const scenes = Array.from({ length: shape[0] }, (_, place) =>
    Array.from(values.subarray(place * shape[1], (place + 1) * shape[1]), (level) => low + (level / 65535) * (high - low)),
  );
  const page = new Page(model, scenes);
  Object.assign(window, { playground: { page, model, Exposure, LeastSquares, Random, poisson } });
}

start().catch((error) => {
  $("trouble").hidden = false;
  throw error;
});
