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
