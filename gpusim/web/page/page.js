// The page: knobs, picture with pan and zoom, histogram.
"use strict";

const find = (id) => document.getElementById(id);
const view = { x: 0, y: 0, scale: 0 };
let camera, shown, raw, wanted = 0, frame = 0, busy = false;

const words = (s) => (s < 0.3 ? `1/${Math.round(1 / s)} s` : `${s.toPrecision(2)} s`);

function draw() {
  const canvas = find("picture");
  canvas.width = canvas.clientWidth;
  canvas.height = canvas.clientHeight;
  if (!shown) return;
  const context = canvas.getContext("2d");
  if (!view.scale) {
    view.scale = Math.min(canvas.width / shown.width, canvas.height / shown.height);
    view.x = (canvas.width - view.scale * shown.width) / 2;
    view.y = (canvas.height - view.scale * shown.height) / 2;
  }
  context.imageSmoothingEnabled = view.scale < 1;
  context.drawImage(shown, view.x, view.y, view.scale * shown.width, view.scale * shown.height);
}

function histogram() {
  const canvas = find("histogram");
  const context = canvas.getContext("2d");
  const bins = new Float64Array(canvas.width);
  let clipped = 0;
  for (const code of raw) {
    bins[Math.min(Math.floor((code / (BUNDLE.most + 1)) * bins.length), bins.length - 1)]++;
    if (code >= BUNDLE.most) clipped++;
  }
  const most = Math.sqrt(Math.max(...bins));
  context.clearRect(0, 0, canvas.width, canvas.height);
  context.fillStyle = "#9ab";
  bins.forEach((count, at) => {
    const high = (canvas.height * Math.sqrt(count)) / most;
    context.fillRect(at, canvas.height - high, 1, high);
  });
  find("clipped").textContent = `${((100 * clipped) / raw.length).toFixed(2)} % saturated`;
}

// Makes what was asked for last; what was asked for meanwhile is made next, the rest is dropped.
async function make() {
  wanted++;
  if (busy) return;
  busy = true;
  try {
    for (let made = 0; made !== wanted; ) {
      made = wanted;
      const started = performance.now();
      const setting = [Number(find("noise").checked), find("iso").selectedIndex, Number(find("exposure").value)];
      find("seconds").textContent = words(BUNDLE.exposures_s[setting[2]]);
      raw = await camera.raw(...setting, frame);
      shown = await createImageBitmap(await camera.picture(raw));
      draw();
      histogram();
      find("time").textContent = `${(performance.now() - started).toFixed(0)} ms`;
    }
    document.body.dataset.ready = "yes";
  } catch (error) {
    tell(error);
  } finally {
    busy = false;
  }
}

function tell(error) {
  find("said").textContent = error.message;
  document.body.dataset.ready = "no";
}

function zoom(factor, x, y) {
  const scale = Math.min(Math.max(view.scale * factor, 0.05), 64);
  view.x = x - ((x - view.x) * scale) / view.scale;
  view.y = y - ((y - view.y) * scale) / view.scale;
  view.scale = scale;
  draw();
}

function listen() {
  const picture = find("picture");
  for (const id of ["exposure", "iso", "noise"]) find(id).addEventListener("input", make);
  find("another").addEventListener("click", () => (frame++, make()));
  find("fit").addEventListener("click", () => ((view.scale = 0), draw()));
  picture.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(event.deltaY < 0 ? 1.2 : 1 / 1.2, event.offsetX, event.offsetY);
  });
  picture.addEventListener("pointerdown", (event) => picture.setPointerCapture(event.pointerId));
  picture.addEventListener("pointermove", (event) => {
    if (!event.buttons) return;
    view.x += event.movementX;
    view.y += event.movementY;
    draw();
  });
  window.addEventListener("resize", draw);
}

async function start() {
  document.title = `${BUNDLE.title}: ${BUNDLE.scene}`;
  find("title").textContent = document.title;
  const certified = BUNDLE.certified === null ? "not certified" : `certified ${BUNDLE.certified.toExponential(1)}`;
  find("error").textContent = `light to ${BUNDLE.tolerance}, ${certified}`;
  for (const iso of BUNDLE.isos) find("iso").append(new Option(iso === null ? "base" : `ISO ${iso}`));
  find("exposure").max = BUNDLE.exposures_s.length - 1;
  find("exposure").value = 15;
  camera = new Camera(await Replay.on(BUNDLE));
  listen();
  await make();
}

start().catch(tell);
