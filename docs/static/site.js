// A page to play with says how high it is, and stands whole in the page that embeds it.
addEventListener("message", ({ data, source }) => {
  for (const frame of document.querySelectorAll("iframe.playable")) {
    if (frame.contentWindow === source && data?.playable > 0) frame.style.height = `${data.playable}px`;
  }
});

// Figures of several panels: a narrow screen shows the panels one below the other, each a part of the same picture.
addEventListener("load", () => {
  for (const [name, parts] of [["halves", 2], ["thirds", 3]]) {
    for (const image of document.querySelectorAll(`img.${name}`)) {
      image.style.setProperty("--panel", image.naturalWidth / parts / image.naturalHeight);
      for (let part = parts - 1; part > 0; part -= 1) {
        const panel = image.cloneNode();
        panel.alt = "";
        panel.classList.add("panel");
        panel.style.objectPosition = `${(100 * part) / (parts - 1)}% 0`;
        image.after(panel);
      }
    }
  }
});
