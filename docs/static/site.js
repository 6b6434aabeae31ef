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

// On a narrow screen a wide figure moves sideways, and the cells of a table of sentences stand one below the other.
addEventListener("load", () => {
  for (const image of document.querySelectorAll(".bd-article a > img"))
    if (image.naturalWidth > 2 * image.naturalHeight) image.parentElement.classList.add("wide");
  for (const table of document.querySelectorAll(".bd-article table")) {
    const heads = [...table.querySelectorAll("thead th")], cells = [...table.querySelectorAll("td")];
    for (const cell of cells) cell.dataset.head = heads[cell.cellIndex]?.textContent.trim() ?? "";
    table.classList.toggle("sentences", heads.length > 0 && cells.some((cell) => cell.textContent.length > 50));
  }
});
