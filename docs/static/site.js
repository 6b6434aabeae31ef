// A page to play with says how high it is, and stands whole in the page that embeds it.
addEventListener("message", ({ data, source }) => {
  for (const frame of document.querySelectorAll("iframe.playable")) {
    if (frame.contentWindow === source && data?.playable > 0) frame.style.height = `${data.playable}px`;
  }
});
