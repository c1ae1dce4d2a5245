// The PSF of the place that is clicked in the overview: the nearest of those given, turned about the axis.
(() => {
  const box = document.querySelector(".overview"), pane = document.querySelector("[data-psf]");
  if (!box || !pane) return;
  const { places, turned, side, pitch, axis } = JSON.parse(pane.dataset.psf);
  const said = document.querySelector(".psf-at"), pen = pane.getContext("2d"), strip = new Image();
  const size = box.dataset.size.split(",").map(Number), shown = box.querySelector("img");
  const far = places.map(([x, y]) => Math.hypot(x, y));
  const nearest = (x, y) => {
    let best = 0, least = Infinity;
    places.forEach((place, n) => {
      const off = turned ? Math.abs(far[n] - Math.hypot(x, y)) : Math.hypot(place[0] - x, place[1] - y);
      if (off < least) { least = off; best = n; }
    });
    return best;
  };
  const draw = (col, row) => {
    const x = (col - axis[0]) * pitch, y = (row - axis[1]) * pitch, n = nearest(x, y);
    // Turned, only the square within the circle is there at every angle.
    const view = turned ? side / Math.SQRT2 : side;
    const wide = strip.naturalHeight, half = pane.width / 2, scale = pane.width / view, whole = side * scale;
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.fillStyle = "#000";
    pen.fillRect(0, 0, pane.width, pane.height);
    pen.translate(half, half);
    if (turned) pen.rotate(Math.atan2(y, x));
    // Sample k / 2 is the chief ray: half a sample beside the middle of the square.
    const first = -whole / 2 - whole / wide / 2;
    pen.drawImage(strip, n * wide, 0, wide, wide, first, first, whole, whole);
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.strokeStyle = "rgba(255, 255, 255, .25)";
    pen.beginPath();
    for (let at = (half / scale / pitch + 0.5) % 1; at * pitch * scale < pane.width; at += 1) {
      const line = Math.round(at * pitch * scale) + 0.5;
      pen.moveTo(line, 0); pen.lineTo(line, pane.height); pen.moveTo(0, line); pen.lineTo(pane.width, line);
    }
    pen.stroke();
    said.textContent = `Row ${Math.floor(row)}, column ${Math.floor(col)}: ${(Math.hypot(x, y) / 1000).toFixed(2)} mm from the axis, PSF of ${(far[n] / 1000).toFixed(2)} mm; ${view.toPrecision(3)} um across.`;
  };
  strip.onload = () => draw(size[0] / 2, size[1] / 2);
  strip.src = pane.dataset.strip;
  box.addEventListener("click", (event) => {
    const edge = shown.getBoundingClientRect();
    draw((event.clientX - edge.left) / edge.width * size[0], (event.clientY - edge.top) / edge.height * size[1]);
  });
})();
