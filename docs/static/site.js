// A figure is a link to itself: on a narrow screen it opens in its full size.
addEventListener("DOMContentLoaded", () => {
  for (const image of document.querySelectorAll(".bd-article img:not(a img)")) {
    const link = document.createElement("a");
    link.href = image.src;
    image.replaceWith(link);
    link.append(image);
  }
});

// A page to play with says how high it is, and stands whole in the page that embeds it.
addEventListener("message", ({ data, source }) => {
  for (const frame of document.querySelectorAll("iframe.playable")) {
    if (frame.contentWindow === source && data?.playable > 0) frame.style.height = `${data.playable}px`;
  }
});

// Figures of several panels: a narrow screen shows the panels one below the other, each a part of the same picture.
// The classes at-N of an image of the class `panels` say where the next panel begins, in thousandths of the width.
addEventListener("load", () => {
  for (const image of document.querySelectorAll("img.panels")) {
    const cuts = [...image.className.matchAll(/\bat-(\d+)/g)].map(([, place]) => place / 1000);
    const parts = [0, ...cuts].map((from, place) => [from, [...cuts, 1][place] - from]);
    for (const [from, share] of parts.reverse()) {
      const panel = from ? image.cloneNode() : image;
      if (from) {
        panel.alt = "";
        panel.classList.add("further");
        image.after(panel);
      }
      panel.style.setProperty("--panel", (share * image.naturalWidth) / image.naturalHeight);
      panel.style.objectPosition = `${(100 * from) / (1 - share)}% 0`;
    }
  }
});
