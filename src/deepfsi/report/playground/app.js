// The page: what the user does, and what is shown of it.

import { AdaptiveView } from "./adaptive.js";
import { accuracyAt, chanceText, drawAnswer, drawCounts, drawCurve, drawHistory, photonsText, wholeText } from "./charts.js";
import { candidates, nextMask } from "./choice.js";
import { Exposure } from "./exposure.js";
import { KnownView } from "./known.js";
import { LookExposure, LookModel } from "./looks.js";
import { Model } from "./model.js";
import { poisson, Random, unpack } from "./numbers.js";
import { $, percent } from "./page.js";
import { LookOptics, Posterior } from "./posterior.js";
import { Pad, show } from "./scene.js";

const SECONDS = 5; // of a whole exposure on the page
const embedded = window !== parent; // as high as it is whole: what is in view is not known

class Page {
  constructor(model, scenes) {
    Object.assign(this, { model, scenes, label: null, playing: false, drawn: {}, seed: 0 });
    this.view = model.prior ? new AdaptiveView(model) : new KnownView(model);
    this.pad = new Pad($("scene"), model, scenes, () => this.drew());
    const { low, high } = model.budget ?? { low: 1e4, high: 1e4 };
    $("light").value = Math.min(Math.max(Math.log10(Math.sqrt(low * high)), 1), 7);
    this.listThumbs();
    this.listen();
    this.choose(0);
  }

  get photons() {
    return 10 ** Number($("light").value);
  }

  listThumbs() {
    this.thumbs = this.scenes.map((scene, place) => {
      const button = document.createElement("button");
      button.type = "button";
      const name = this.model.classes[this.model.scenes.labels[place]];
      button.setAttribute("aria-label", `Test scene ${place + 1}, class ${name}`);
      button.title = name;
      const canvas = document.createElement("canvas");
      show(canvas, this.model, scene);
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
    this.label = this.chosen = null;
    this.scene = this.pad.scene;
    show(this.pad.canvas, this.model, this.scene);
    this.waiting ??= requestAnimationFrame(() => {
      this.waiting = null;
      this.renew();
    });
  }

  /** A new exposure, of which nothing is shown yet. */
  renew() {
    this.pause();
    const { model, view, scene, photons, seed } = this;
    this.exposure = view.expose(scene, photons, seed);
    this.time = 0;
    this.drawn = {};
    show(this.pad.canvas, model, scene);
    this.thumbs.forEach((thumb, place) => thumb.setAttribute("aria-pressed", place === this.chosen));
    this.sayLight();
    this.draw();
  }

  sayLight() {
    const { model, photons } = this;
    drawCurve($("curve"), model, photons);
    $("photons").textContent = `${photonsText(photons)} photons`;
    $("light").setAttribute("aria-valuetext", $("photons").textContent);
    const share = accuracyAt(model.curve, photons);
    const used = accuracyAt(model.curve, photons, "used");
    const mean = Math.abs(used - 1) < 0.05 ? "" : ` (they take ${used.toFixed(1)} times it in the mean)`;
    const of = `${percent(share)} of ${model.test.images} test scenes`;
    $("light-words").textContent = `About ${of} are right with so much light${mean}.`;
    const name = this.label === null ? null : model.classes[this.label];
    $("scene-words").textContent = name === null ? "Your own scene." : `Class ${name}. Draw, or choose another:`;
  }

  /** Counts [rail][mask] of all detectors together. */
  byMask(counts) {
    const { model } = this;
    return Array.from({ length: model.rails }, (_, rail) =>
      Array.from({ length: model.masks }, (_, mask) => {
        let sum = 0;
        for (let d = 0; d < model.detectors; d++) sum += counts[model.place(rail, mask, d)];
        return sum;
      }),
    );
  }

  /** Draw the moment `time`; what has not changed since it was last drawn stays. */
  draw() {
    const { exposure, model, drawn, view } = this;
    const { frames } = exposure;
    exposure.reach(frames.filter((frame) => frame.begin <= this.time + 1e-12).length);
    this.time = Math.min(this.time, exposure.end);
    const count = frames.filter((frame) => frame.end <= this.time + 1e-12).length;
    const now = this.time < exposure.end - 1e-9 ? frames[count] : null;
    const part = now ? (this.time - now.begin) / now.share : 0;
    const { counts } = exposure.after(count);
    if (now) now.places.forEach((place, i) => (counts[place] += Math.floor(now.counts[i] * part)));
    const byMask = (each) => this.byMask(each);
    this.most = Math.max(view.most(exposure, byMask), drawn.count === undefined ? 0 : this.most);
    drawCounts($("counts"), model, byMask(counts), this.most, now && now.mask, view.names);
    const total = counts.reduce((a, b) => a + b, 0);
    $("count-words").textContent = wholeText(total);
    const place = Math.round((this.time / exposure.length) * 1000);
    $("time").value = place;
    $("time").setAttribute("aria-valuetext", `${Math.round(place / 10)} % of the exposure`);
    $("play").textContent = this.playing ? "Pause" : "Play";
    const share = this.time / exposure.length;
    const words = [`${percent(share)} of the exposure`, ...view.state(exposure, count, now)];
    $("state").textContent = [...words, ...(now ? [] : ["finished"])].join(" · ");
    const shown = exposure.together ? null : this.time > 0 ? now : frames[0]; // null: all masks
    if (drawn.frame !== shown || drawn.count === undefined) view.drawFrame(exposure, shown, count);
    if (drawn.count !== count) this.drawAnswer(count);
    this.drawn = { ...this.drawn, count, frame: shown };
  }

  drawAnswer(count) {
    const { exposure, model } = this;
    const unlike = exposure.unlike(count);
    const chances = unlike ? null : exposure.answer(count);
    const top = drawAnswer($("answer"), model, chances);
    drawHistory($("history"), exposure, count, top);
    const none = "No probabilities are given for this scene.";
    const untested = model.usual ? "" : " Whether counts look like those of the training is not tested: too few scenes.";
    $("answer-words").textContent = unlike ? none : this.view.about(exposure) + untested;
    $("verdict").textContent = this.verdict(top, chances);
  }

  verdict(top, chances) {
    const { exposure, model, label } = this;
    if (this.time === 0 && !this.playing) return "Nothing is exposed yet: press Expose.";
    const { stop } = exposure;
    if (this.time < exposure.end - 1e-9) {
      return `The exposure goes on.${chances ? ` Likeliest so far: ${model.classes[top]}.` : ""}`;
    }
    if (!chances) return "No answer: these counts do not look like those of the training.";
    const name = model.classes[top];
    const right = label === null ? "" : top === label ? ", which is right" : `, which is wrong: it is ${model.classes[label]}`;
    const dim = model.tooDim(exposure.photons) ? "Too little light for this design: its answer is hardly more than a guess. " : "";
    const answer = `${dim}Answer: ${name}${right}. Probability ${chanceText(chances[top])}.`;
    if (!stop) return answer;
    return `${answer} It stopped after look ${stop.count} of ${model.looks}, and saved ${percent(stop.saved)} of the light.`;
  }

  /** Draw new counts and play them where one sees it; who asks for less motion sees the end at once. */
  expose() {
    this.seed += 1;
    this.renew();
    const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    const { bottom, height } = $("watch").getBoundingClientRect();
    const block = height > innerHeight ? "start" : "nearest";
    if (embedded || bottom > innerHeight) $("watch").scrollIntoView({ block, behavior: still ? "instant" : "smooth" });
    this.time = still ? this.exposure.length : 0;
    if (still) this.draw();
    else this.play();
  }

  play() {
    if (this.time >= this.exposure.end - 1e-9) this.time = 0;
    this.playing = true;
    let before = null;
    const tick = (now) => {
      if (!this.playing) return;
      const passed = before === null ? 0 : (now - before) / 1000;
      before = now;
      this.time += (passed * this.exposure.length) / SECONDS;
      if (this.time >= this.exposure.end) {
        this.time = this.exposure.end;
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

  listen() {
    const on = (id, event, act) => $(id).addEventListener(event, act);
    on("light", "input", () => this.renew());
    on("expose", "click", () => this.expose());
    on("play", "click", () => (this.playing ? (this.pause(), this.draw()) : this.play()));
    on("time", "input", () => {
      this.pause();
      this.time = (Number($("time").value) / 1000) * this.exposure.length;
      this.draw();
    });
    on("clear", "click", () => this.pad.clear());
    let width = innerWidth;
    addEventListener("resize", () => {
      if (innerWidth === width) return;
      width = innerWidth;
      this.sayLight();
      this.drawn = {};
      this.draw();
    });
  }
}

/** Tell a page that embeds this one how high it is, so that nothing need scroll within. */
function tellHeight() {
  const whole = document.documentElement;
  new ResizeObserver(() => parent.postMessage({ playable: Math.ceil(whole.getBoundingClientRect().height) }, "*")).observe(whole);
}

async function start() {
  if (embedded) tellHeight();
  const payload = JSON.parse($("payload").textContent);
  const model = await (payload.prior ? LookModel : Model).load(payload);
  const { shape, values } = await unpack(payload.scenes.levels);
  const { low, high } = payload.scenes;
  const scenes = Array.from({ length: shape[0] }, (_, place) =>
    Array.from(values.subarray(place * shape[1], (place + 1) * shape[1]), (level) => low + (level / 65535) * (high - low)),
  );
  const page = new Page(model, scenes);
  const optics = { LookOptics, Posterior, candidates, nextMask };
  const parts = { Exposure, LookExposure, Random, poisson, ...optics };
  Object.assign(window, { playground: { page, model, ...parts } });
}

start().catch((error) => {
  $("trouble").hidden = false;
  throw error;
});
