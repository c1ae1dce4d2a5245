// Loupe over the overview: pixels of developed.png beside the page, or of the overview where it is not there.
(() => {
  const box = document.querySelector(".overview"), lens = document.querySelector(".loupe");
  if (!box || !lens) return;
  const shown = box.querySelector("img"), whole = new Image(), pen = lens.getContext("2d");
  const said = document.querySelector(".loupe-at"), size = box.dataset.size.split(",").map(Number);
  let source = shown, zoom = 4, at = null;
  whole.onload = () => { source = whole; if (at) draw(); };
  whole.src = box.dataset.whole;
  const draw = () => {
    const [cols, rows] = size, side = lens.width / zoom, scale = source.naturalWidth / cols;
    const x = Math.min(Math.max(at[0] * cols, 0), cols - 1), y = Math.min(Math.max(at[1] * rows, 0), rows - 1);
    pen.imageSmoothingEnabled = false;
    pen.fillStyle = "#000";
    pen.fillRect(0, 0, lens.width, lens.height);
    pen.drawImage(source, (x - side / 2) * scale, (y - side / 2) * scale, side * scale, side * scale, 0, 0, lens.width, lens.height);
    lens.style.display = "block";
    const wide = box.clientWidth, high = shown.clientHeight, half = lens.offsetWidth / 2;
    lens.style.left = Math.min(Math.max(at[0] * wide - half, 0), Math.max(wide - 2 * half, 0)) + "px";
    lens.style.top = Math.min(Math.max(at[1] * high - half, 0), Math.max(high - 2 * half, 0)) + "px";
    said.textContent = `row ${Math.floor(y)}, column ${Math.floor(x)}, ${zoom} times`;
  };
  const move = (event) => {
    const edge = shown.getBoundingClientRect();
    at = [(event.clientX - edge.left) / edge.width, (event.clientY - edge.top) / edge.height];
    draw();
  };
  const closer = (more) => { zoom = Math.min(Math.max(more ? zoom * 2 : zoom / 2, 1), 32); if (at) draw(); };
  box.addEventListener("pointermove", move);
  box.addEventListener("pointerdown", move);
  box.addEventListener("pointerleave", () => { lens.style.display = "none"; at = null; });
  box.addEventListener("wheel", (event) => { event.preventDefault(); closer(event.deltaY < 0); }, { passive: false });
  for (const knob of document.querySelectorAll("[data-zoom]")) knob.addEventListener("click", () => closer(knob.dataset.zoom === "in"));
})();
