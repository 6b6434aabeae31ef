// What the page shows of a design whose masks are known before an exposure.

import { places } from "./charts.js";
import { Exposure } from "./exposure.js";
import { $, percent, roundUp } from "./page.js";
import { paint, tile } from "./scene.js";

const MOSAIC = 64; // masks shown side by side

export class KnownView {
  constructor(model) {
    this.model = model;
    this.names = { one: "mask 1", all: `mask ${model.masks}`, counts: "counts of each mask" };
  }

  expose(scene, photons, seed) {
    return new Exposure(this.model, scene, photons, seed);
  }

  /** Largest count of the charts' axis, of counts [rail][mask] of a whole exposure. */
  most(exposure, byMask) {
    return roundUp(Math.max(...byMask(exposure.after(exposure.frames.length).counts).flat(), 4));
  }

  /** What is on the device. */
  state(exposure, count, now) {
    if (!now || exposure.together) return [];
    return [`frame ${count + 1} of ${exposure.frames.length}`];
  }

  about(exposure) {
    if (exposure.together) return "All masks see light at once: this is the answer to the light so far.";
    return "The network answers after the last mask.";
  }

  drawFrame(exposure, frame) {
    const { model } = this;
    const canvas = $("mask");
    $("h-device").textContent = frame ? "On the device now" : "Masks";
    if (!frame) {
      this.drawMosaic();
      return;
    }
    const { mask, rails, share } = frame;
    const [rail] = rails;
    const pattern = Array.from({ length: model.pixels }, (_, i) => model.entry(rail, mask, i));
    let peak = model.law.equal_times ? share : model.peaks[rail][mask]; // of a mirror that is always ON
    if (rails.length > 1) peak = model.entry(0, mask, 0) + model.entry(1, mask, 0);
    const device = pattern.map((each) => each / peak);
    const { high } = model.scenes;
    const passed = device.map((each, i) => each * exposure.scene[i]);
    paint(canvas, model.image_shape, (i) => device[i]);
    paint($("through"), model.image_shape, (i) => passed[i] / high);
    $("passed").hidden = false;
    canvas.classList.toggle("rail-minus", rail === 1);
    canvas.classList.toggle("rail-plus", rail === 0);
    const which = rails.length > 1 ? ", both arms" : model.rails === 2 ? [", positive rail", ", negative rail"][rail] : "";
    const arms = "White goes in one direction, black in the other. ";
    const all = `White goes to the detector${model.detectors > 1 ? "s" : ""}. `;
    $("h-through").textContent = rails.length > 1 ? "Light in the first direction" : "Light that passes";
    $("mask-words").textContent =
      `Mask ${mask + 1} of ${model.masks}${which}, shown for ${percent(share / exposure.length)} of the exposure. ` +
      (rails.length > 1 ? arms : all);
  }

  /** All masks side by side: as they are used at once, or before and after an exposure. */
  drawMosaic() {
    const { model } = this;
    const canvas = $("mask");
    const count = Math.min(model.masks, MOSAIC);
    canvas.classList.remove("rail-plus", "rail-minus");
    const value = (mask, i) => model.matrix[mask * model.pixels + i];
    const peaks = Array.from({ length: count }, (_, mask) => Math.max(model.peaks[0][mask], model.peaks[1]?.[mask] ?? 0));
    const dwells = places(count).map((mask) => model.entry(0, mask, 0) + (model.rails > 1 ? model.entry(1, mask, 0) : 0));
    tile(canvas, model.image_shape, count, Math.ceil(Math.sqrt(count)), (mask, i) => {
      const share = value(mask, i) / peaks[mask];
      if (model.rails === 1) return share;
      if (model.law.arms === 2) return (1 + value(mask, i) / dwells[mask]) / 2;
      const bright = share > 0 ? [86, 180, 255] : [255, 125, 59];
      return bright.map((each) => each * Math.abs(share));
    });
    if ($("passed")) $("passed").hidden = true;
    const some = count < model.masks ? `The first ${count} of ${model.masks} masks` : `All ${model.masks} masks`;
    const dual = model.law.arms === 2 ? " White goes in one direction, black in the other." : " Blue is counted by the positive rail, orange by the negative one.";
    const signs = model.rails === 2 ? dual : " White is counted, black is not.";
    $("mask-words").textContent = `${some}, each to its own brightest value.${signs}`;
  }
}
