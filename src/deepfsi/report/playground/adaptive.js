// What the page shows of adaptive masks: each as it is made, and what is known of the scene by then.

import { wholeText } from "./charts.js";
import { LookExposure } from "./looks.js";
import { $, roundUp } from "./page.js";
import { paint, show } from "./scene.js";

export class AdaptiveView {
  constructor(model) {
    this.model = model;
    this.names = { one: "look 1", all: `look ${model.looks}`, counts: "counts of each look" };
  }

  expose(scene, photons, seed) {
    return new LookExposure(this.model, scene, photons, seed);
  }

  /** Largest count of the charts' axis: of those that there are, and of those to be expected. */
  most(exposure, byMask) {
    const { model } = this;
    const light = exposure.scene.reduce((a, b) => a + b, 0) / model.summed_reflectance;
    const usual = 1.5 * Math.max(...model.counted) * exposure.photons * light + model.dark * Math.max(...model.shares);
    return roundUp(Math.max(...byMask(exposure.after(exposure.taken).counts).flat(), usual / model.rails, 4));
  }

  state(exposure, count, now) {
    return now ? [`look ${count + 1} of ${this.model.looks}`] : [];
  }

  about() {
    const [scenes, of] = [this.model.known.scenes, this.model.known.of].map(wholeText);
    const known = this.model.known.centres ? "centres of clusters of training scenes" : "training scenes";
    const some = scenes === of ? `the ${of} ${known}` : `${scenes} of the ${of} ${known}`;
    return `Posterior of the class. This page knows ${some}.`;
  }

  drawFrame(exposure, frame, count) {
    const { model } = this;
    const { pattern, look } = frame ?? exposure.frames[count - 1];
    $("h-device").textContent = !frame ? "Last mask" : look ? "On the device now" : "First mask";
    paint($("mask"), model.image_shape, (i) => pattern[i]);
    show($("through"), model, exposure.scenes[count]);
    const made = look ? `made from the counts of the ${look === 1 ? "look" : `${look} looks`} before` : "made before anything is counted";
    const lit = pattern.reduce((a, b) => a + b, 0) / pattern.length;
    $("mask-words").textContent =
      `Mask ${look + 1}, ${made}: ${Math.round(lit * 100)} % of the mirrors are ON` +
      (model.rails === 2 ? " (white); the others send their light to the second arm." : " (white) and send their light to the detector" + (model.detectors > 1 ? "s." : "."));
  }
}
