// The page of `augnerf view`: a camera, the pictures that it asks for, and what is drawn from them.
"use strict";

const $ = (id) => document.getElementById(id);
// Pixels along the longer side of a sharp picture, or fewer if the window is smaller.
const SHARP = 400;
// Milliseconds that a picture may take. The program makes it as large as it can.
const QUICK = 200; // while the camera moves
const STEPS = [QUICK, 1500, null]; // when it is still: the last picture is sharp, however long it takes
const STILL_AFTER = 180; // milliseconds without a move
const ANSWER = 20000; // milliseconds within which the program says how its runs stand
const PAGE = Math.random().toString(36).slice(2, 12);

let scene, runs = [];
// The camera: place, axes (right, up, back), vertical field of view, and what it turns around.
let camera = null;
// The scene's own view that the camera has not left, and the last one that it was at.
let own = null, lastView = "";
let border = 0.5;
const path = [];
const shown = { left: null, right: null }; // the newest pictures, as ImageBitmap

// ---- Vectors -------------------------------------------------------------------------------------------------------

const add = (a, b, s = 1) => a.map((x, i) => x + s * b[i]);
const dot = (a, b) => a.reduce((sum, x, i) => sum + x * b[i], 0);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => { const length = Math.hypot(...a); return a.map((x) => x / length); };
// Turns a vector around a unit axis.
const turned = (v, axis, angle) => {
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  const across = cross(axis, v), along = dot(axis, v) * (1 - c);
  return v.map((x, i) => x * c + across[i] * s + axis[i] * along);
};
// Makes the axes perpendicular again: turning adds rounding.
const squared = (c) => {
  c.back = unit(c.back);
  c.right = unit(add(c.right, c.back, -dot(c.right, c.back)));
  c.up = cross(c.back, c.right);
};

// ---- Camera --------------------------------------------------------------------------------------------------------

function cameraOf(view) {
  const p = view.pose, column = (i) => [p[i], p[4 + i], p[8 + i]];
  const c = { right: column(0), up: column(1), back: column(2), at: column(3), fov: view.fov };
  const far = runs[0].distance || 4;
  const toCentre = scene.centre ? dot(add(c.at, scene.centre, -1), c.back) : far;
  c.distance = toCentre > 0 ? toCentre : far;
  return c;
}

const pose = (c) => [0, 1, 2].flatMap((i) => [c.right[i], c.up[i], c.back[i], c.at[i]]);

function turn(x, y) {
  const pivot = add(camera.at, camera.back, -camera.distance);
  const upright = scene.centre ? scene.up : camera.up;
  for (const [axis, angle] of [[upright, -x], [camera.right, -y]]) {
    for (const name of ["right", "up", "back"]) camera[name] = turned(camera[name], axis, angle);
  }
  squared(camera);
  camera.at = add(pivot, camera.back, camera.distance);
  moved();
}

function pan(x, y) {
  camera.at = add(add(camera.at, camera.right, -x * camera.distance), camera.up, y * camera.distance);
  moved();
}

function zoom(factor) {
  const pivot = add(camera.at, camera.back, -camera.distance);
  camera.distance = Math.min(Math.max(camera.distance * factor, 1e-3), 1e5);
  camera.at = add(pivot, camera.back, camera.distance);
  moved();
}

// Moves the camera and its pivot along its own axes.
function fly(right, up, back) {
  const step = 0.06 * camera.distance;
  camera.at = add(add(add(camera.at, camera.right, right * step), camera.up, up * step), camera.back, back * step);
  moved();
}

function jump(id) {
  own = scene.views.find((view) => view.id === id);
  lastView = $("views").value = id;
  camera = cameraOf(own);
  rayAt = null;
  rows();
  changed(true);
}

let stillTimer = 0;
function moved() {
  own = null;
  $("views").value = "";
  rayAt = null;
  rows();
  changed(false);
  clearTimeout(stillTimer);
  stillTimer = setTimeout(() => changed(true), STILL_AFTER);
}

// ---- Pictures ------------------------------------------------------------------------------------------------------

let wanted = null; // the newest request that has not been sent
let busy = false;
let outdated = false; // a training has gone on since the newest request
let sharpening = null; // ends the requests of a still picture when a newer one is wanted
let turnNumber = 0;

function size(longer) {
  const like = own || scene.views[0];
  const window = Math.round(($("stage").clientWidth || longer) * devicePixelRatio);
  const width = Math.min(window, longer * like.width / Math.max(like.width, like.height));
  return [Math.max(8, Math.round(width)), Math.max(8, Math.round(width * like.height / like.width))];
}

let shownAs = ""; // what the newest pictures show

function changed(still) {
  wanted = { still };
  $("stage").classList.toggle("stale", asked(pictures(still)) !== shownAs);
  if (sharpening) sharpening.abort();
  if (!busy) next();
}

// What some pictures show, whatever their size.
const asked = (list) => JSON.stringify([list, layer(), $("scale").value, pose(camera), camera.fov]);

function sitesOn() {
  return [...document.querySelectorAll("#sites input:checked")].map((box) => box.value);
}

// The two pictures that the page shows: what is asked for, and how it is called. The right one may be missing. A search takes
// many passes, so it waits until the camera is still.
function pictures(still = true) {
  const beside = $("beside").value;
  const attacked = still ? sitesOn() : [];
  const first = { run: 0, sites: [], label: runs[0].label };
  if ($("photograph").checked && own) return [first, { photograph: own.id, label: "photograph" }];
  if (beside.startsWith("run")) {
    const run = Number(beside.slice(3));
    return [{ ...first, sites: attacked }, { run, sites: attacked.filter((site) => runs[run].sites.includes(site)), label: runs[run].label }];
  }
  if (beside === "attack" && attacked.length) {
    return [{ ...first, label: "clean pass" }, { run: 0, sites: attacked, label: `worst case of ${attacked.join(", ")}` }];
  }
  return [{ ...first, sites: attacked, label: attacked.length ? `worst case of ${attacked.join(", ")}` : first.label }];
}

function query(picture, [width, height], slot) {
  // Both pictures take turns: a newer wish for one ends the search for the other.
  const q = new URLSearchParams({ page: slot === "ray" ? `${PAGE}-ray` : PAGE, turn: ++turnNumber, width, height, run: picture.run });
  if (own) q.set("view", own.id); else { q.set("pose", pose(camera).join(",")); q.set("fov", camera.fov); }
  if (picture.sites.length) { q.set("sites", picture.sites.join(",")); q.set("scale", $("scale").value); }
  return q;
}

async function next() {
  if (!wanted) return;
  const { still } = wanted;
  wanted = null;
  busy = true;
  const list = pictures(still), name = asked(list);
  sharpening = still ? new AbortController() : null;
  try {
    if (still) status("Rendering …");
    const steps = !still ? [QUICK] : name === shownAs ? STEPS.slice(1) : STEPS;
    const started = performance.now();
    for (const within of steps) {
      const { found, milliseconds, done } = await make(list, within, still);
      show(list, found, name);
      const [columns, lines] = [found[0].width, found[0].height], [width, height] = size(SHARP);
      if (done || !still) {
        const waiting = !still && sitesOn().length ? " without the worst case, while you move" : "";
        const after = Math.round(performance.now() - started);
        status(`${columns} × ${lines} in ${Math.round(milliseconds)} ms, shown after ${after} ms${waiting}`);
        break;
      }
      const seconds = Math.ceil(milliseconds / 1000 * width * height / (columns * lines));
      status(`${columns} × ${lines} so far. Rendering ${width} × ${height}: about ${seconds} s …`);
    }
  } catch (error) {
    if (!(error instanceof Superseded)) status(error.message, true);
  } finally {
    busy = false;
    sharpening = null;
    if (!wanted && outdated) wanted = { still: true };
    outdated = false;
    if (wanted) next();
  }
}

// Asks for the pictures of a list. `done` tells whether they are as large as they can be.
async function make(list, within, still) {
  const columns = size(SHARP), found = [];
  let milliseconds = 0, done = true;
  for (const [slot, picture] of list.entries()) {
    if (picture.photograph) {
      found[slot] = await bitmap(`photograph?view=${encodeURIComponent(picture.photograph)}`);
      continue;
    }
    const q = query(picture, columns, slot);
    q.set("layer", layer());
    if (within) q.set("within", within / list.length);
    if (!still) q.set("moving", "1");
    const reply = await get(`picture?${q}`, still ? { signal: sharpening.signal } : {});
    milliseconds += Number(reply.headers.get("X-Milliseconds"));
    found[slot] = await createImageBitmap(await reply.blob());
    done = done && found[slot].width === columns[0];
    // A newer wish wins: a moving camera needs no second sharp picture.
    if (wanted && still) throw new Superseded();
  }
  return { found, milliseconds, done };
}

function show(list, found, name) {
  [shown.left, shown.right] = [found[0], found[1] || null];
  shownAs = name;
  $("stage").classList.remove("stale");
  $("left-label").textContent = list.length > 1 ? list[0].label : "";
  $("right-label").textContent = list.length > 1 ? list[1].label : "";
  showDepths();
  draw();
}

// The colours of depth with their numbers, under a picture of it.
function showDepths() {
  const { depths } = runs[0];
  $("depths").hidden = layer() !== "depth" || !depths;
  if ($("depths").hidden) return;
  [$("near").textContent, $("far").textContent] = depths.map((depth) => depth.toPrecision(3));
  $("unit").textContent = scene.ndc ? "NDC" : "depth in scene units";
  $("colours").style.background = `linear-gradient(to right, ${scene.depth_colours.map((rgb) => `rgb(${rgb})`)})`;
}

class Superseded extends Error {}

async function get(address, options) {
  let reply;
  try {
    reply = await fetch(address, options);
  } catch (error) {
    if (error.name === "AbortError") throw new Superseded();
    lost(true);
    throw new Error("The program does not answer.");
  }
  lost(false);
  if (reply.status === 409) throw new Superseded();
  if (!reply.ok) throw new Error(await reply.text());
  return reply;
}

const bitmap = async (address) => createImageBitmap(await (await get(address)).blob());

// Draws the newest pictures: one, two with a border between them, or their difference.
function draw() {
  const { left, right } = shown;
  if (!left) return;
  const canvas = $("picture");
  const [width, height] = size(SHARP);
  canvas.width = Math.max(width, right ? right.width : 0);
  canvas.height = Math.round(canvas.width * height / width);
  const c = canvas.getContext("2d", { willReadFrequently: true });
  const whole = [0, 0, canvas.width, canvas.height];
  const difference = right && $("as").value === "difference";
  $("slider").hidden = !right || difference;
  $("psnr").textContent = "";
  if (difference) {
    c.drawImage(left, ...whole);
    const a = c.getImageData(...whole);
    c.drawImage(right, ...whole);
    const b = c.getImageData(...whole);
    const gain = Number($("gain").value) || 1;
    let squares = 0;
    for (let i = 0; i < a.data.length; i += 4) {
      const by = [0, 1, 2].map((channel) => Math.abs(a.data[i + channel] - b.data[i + channel]));
      squares += dot(by, by);
      b.data.fill(gain * (by[0] + by[1] + by[2]) / 3, i, i + 3);
    }
    c.putImageData(b, 0, 0);
    // Of pictures that were scaled it would say little.
    if (layer() === "colour" && left.width === canvas.width && right.width === canvas.width) {
      const psnr = -10 * Math.log10(squares / (3 * canvas.width * canvas.height) / 255 ** 2);
      $("psnr").textContent = `PSNR between the two: ${squares ? psnr.toFixed(2) : "∞"} dB`;
    }
    place();
    return;
  }
  c.drawImage(left, ...whole);
  if (right) {
    const x = border * canvas.width;
    c.save();
    c.beginPath();
    c.rect(x, 0, canvas.width - x, canvas.height);
    c.clip();
    c.drawImage(right, ...whole);
    c.restore();
  }
  place();
}

// Where the picture is within its element, which may be taller or wider.
function frame() {
  const canvas = $("picture"), box = canvas.getBoundingClientRect();
  const scale = Math.min(box.width / canvas.width, box.height / canvas.height) || 1;
  const [width, height] = [canvas.width * scale, canvas.height * scale];
  return { left: box.left + (box.width - width) / 2, top: box.top + (box.height - height) / 2, width, height };
}

function place() {
  const at = frame(), stage = $("stage").getBoundingClientRect(), slider = $("slider");
  slider.style.left = `${at.left - stage.left + border * at.width}px`;
  slider.style.top = `${at.top - stage.top}px`;
  slider.style.height = `${at.height}px`;
  $("left-label").style.left = `${at.left - stage.left + 6}px`;
  $("right-label").style.right = `${stage.right - at.left - at.width + 6}px`;
  slider.setAttribute("aria-valuenow", Math.round(100 * border));
}

const layer = () => document.querySelector("#layers input:checked").value;

function status(words, wrong = false) {
  $("status").textContent = words;
  $("status").classList.toggle("error", wrong);
}

function lost(is) { $("lost").hidden = !is; }

// ---- The ray under the pointer -------------------------------------------------------------------------------------

let rayAt = null; // fractions of the picture

async function showRay() {
  if (!rayAt) return;
  $("ray-note").textContent = "Waiting for the ray …";
  const columns = size(SHARP);
  const q = query({ run: 0, sites: sitesOn() }, columns, "ray");
  q.set("x", Math.min(columns[0] - 1, Math.floor(rayAt[0] * columns[0])));
  q.set("y", Math.min(columns[1] - 1, Math.floor(rayAt[1] * columns[1])));
  try {
    drawRay(await (await get(`ray?${q}`)).json());
  } catch (error) {
    if (!(error instanceof Superseded)) $("ray-note").textContent = error.message;
  }
}

function drawRay({ clean, attacked }) {
  const canvas = $("ray"), ratio = devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth || 320, 190];
  [canvas.width, canvas.height] = [width * ratio, height * ratio];
  const c = canvas.getContext("2d");
  c.scale(ratio, ratio);
  const ink = getComputedStyle(document.body).color;
  const mark = getComputedStyle(document.body).getPropertyValue("--mark");
  const [left, right, top, bottom] = [6, width - 6, 16, height - 48];
  const [near, far] = [clean.t[0], clean.t[clean.t.length - 1]];
  const x = (t) => left + (right - left) * (t - near) / (far - near || 1);
  const all = attacked ? [clean, attacked] : [clean];
  // Densities reach from fractions to thousands.
  const most = Math.max(1, ...all.flatMap((samples) => samples.density));
  const ofDensity = (d) => bottom - (bottom - top) * Math.log1p(Math.max(0, d)) / Math.log1p(most);
  const ofShare = (w) => bottom - (bottom - top) * w;
  const line = (samples, y, colour, dash) => {
    c.beginPath();
    c.setLineDash(dash);
    samples.forEach((value, i) => c.lineTo(x(value[0]), y(value[1])));
    c.strokeStyle = colour;
    c.lineWidth = 1.5;
    c.stroke();
    c.setLineDash([]);
  };
  c.strokeStyle = ink; c.globalAlpha = 0.35;
  c.strokeRect(left, top, right - left, bottom - top);
  c.globalAlpha = 1;
  all.forEach((samples, i) => {
    const dash = i ? [4, 3] : [];
    const pairs = (values) => values.map((value, k) => [samples.t[k], value]);
    line(pairs(samples.density), ofDensity, ink, dash);
    line(pairs(samples.weights), ofShare, mark, dash);
    line(pairs(samples.transmittance), ofShare, "#999", dash);
    // Colour along the ray, as opaque as the sample counts.
    samples.rgb.forEach((rgb, k) => {
      c.fillStyle = `rgb(${rgb.map((value) => Math.round(255 * value)).join(",")})`;
      const next = samples.t[k + 1] === undefined ? far : samples.t[k + 1];
      c.fillRect(x(samples.t[k]), bottom + 4 + 12 * i, Math.max(1, x(next) - x(samples.t[k])), 10);
    });
  });
  c.font = "11px system-ui, sans-serif";
  [["density (log)", ink], ["weight", mark], ["transmittance", "#999"]].forEach(([text, colour], i) => {
    c.fillStyle = colour;
    c.fillText(text, left + i * 95, 11);
  });
  // Numbers of the axes: density at its greatest, weight and transmittance, and where along the ray.
  c.fillStyle = ink;
  c.fillText(most.toPrecision(3), left + 3, top + 11);
  c.fillStyle = mark;
  c.fillText("1", right - 9, top + 11);
  c.fillStyle = ink;
  [["left", near], ["center", (near + far) / 2], ["right", far]].forEach(([align, t]) => {
    c.textAlign = align;
    c.fillText(t.toPrecision(3), x(t), height - 5);
  });
  const colour = (rgb) => rgb.map((value) => Math.round(255 * value)).join(", ");
  const words = attacked ? `Solid: clean, RGB ${colour(clean.pixel)}. Dashed: worst case, RGB ${colour(attacked.pixel)}.` : `RGB ${colour(clean.pixel)}.`;
  $("ray-note").textContent = `${words} ${scene.ndc ? "NDC" : "Depth"} from ${near.toPrecision(3)} to ${far.toPrecision(3)}; colours below.`;
}

// ---- Pointer, keys and buttons -------------------------------------------------------------------------------------

const pointers = new Map();
let travelled = 0;

function pointer(event) {
  const at = frame();
  return [(event.clientX - at.left) / at.width, (event.clientY - at.top) / at.height];
}

function listen() {
  const stage = $("stage");
  stage.addEventListener("contextmenu", (event) => event.preventDefault());
  stage.addEventListener("pointerdown", (event) => {
    if (event.target === $("slider")) return;
    stage.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, pointer(event));
    travelled = 0;
  });
  stage.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before || !camera) return;
    const now = pointer(event);
    const [x, y] = [now[0] - before[0], now[1] - before[1]];
    travelled += Math.hypot(x, y);
    if (pointers.size === 2) {
      const other = [...pointers].find(([id]) => id !== event.pointerId)[1];
      const gap = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]);
      zoom(gap(before) / Math.max(gap(now), 1e-3));
      pan(x / 2, y / 2);
    } else if (travelled > 0.01) {
      if (event.shiftKey || event.buttons === 2 || event.buttons === 4) pan(x, y); else turn(3 * x, 3 * y);
    }
    pointers.set(event.pointerId, now);
  });
  for (const name of ["pointerup", "pointercancel"]) {
    stage.addEventListener(name, (event) => {
      if (!pointers.delete(event.pointerId) || name === "pointercancel" || travelled > 0.01) return;
      const at = pointer(event);
      if (at.every((value) => value >= 0 && value < 1)) { rayAt = at; showRay(); }
    });
  }
  stage.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(Math.sign(event.deltaY) * Math.min(Math.abs(event.deltaY), 100) * 0.0015));
  }, { passive: false });
  const steps = {
    w: [0, 0, -1], s: [0, 0, 1], a: [-1, 0, 0], d: [1, 0, 0], q: [0, -1, 0], e: [0, 1, 0],
    ArrowUp: [0, 0, -1], ArrowDown: [0, 0, 1], ArrowLeft: [-1, 0, 0], ArrowRight: [1, 0, 0],
  };
  stage.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target === $("slider")) return;
    const step = steps[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!step || !camera) return;
    event.preventDefault();
    fly(...step);
  });
  const slider = $("slider");
  slider.addEventListener("pointerdown", (event) => slider.setPointerCapture(event.pointerId));
  slider.addEventListener("pointermove", (event) => {
    if (!event.buttons) return;
    border = Math.min(1, Math.max(0, pointer(event)[0]));
    draw();
  });
  slider.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: -0.02, ArrowRight: 0.02 }[event.key];
    if (!step) return;
    event.preventDefault();
    border = Math.min(1, Math.max(0, border + step));
    draw();
  });
  $("beside").addEventListener("change", () => {
    // Of no site there would be nothing to see.
    if ($("beside").value === "attack" && !sitesOn().length) document.querySelectorAll("#sites input").forEach((box) => { box.checked = true; });
  });
  for (const id of ["beside", "photograph", "scale"]) $(id).addEventListener("change", () => { rows(); changed(true); showRay(); });
  for (const id of ["as", "gain"]) $(id).addEventListener("change", () => { rows(); draw(); });
  $("scale").addEventListener("input", () => { $("scale-out").value = $("scale").value; });
  $("views").addEventListener("change", () => jump($("views").value || lastView));
  $("reset").addEventListener("click", () => jump(lastView));
  $("save").addEventListener("click", save);
  $("record").addEventListener("click", () => {
    const p = pose(camera);
    path.push([p.slice(0, 4), p.slice(4, 8), p.slice(8, 12)]);
    $("download").disabled = false;
    $("download").textContent = `Save path (${path.length})`;
  });
  $("download").addEventListener("click", downloadPath);
  addEventListener("resize", () => { place(); if (camera) { clearTimeout(stillTimer); stillTimer = setTimeout(() => changed(true), STILL_AFTER); } });
}

function rows() {
  const two = pictures().length > 1;
  $("as-row").hidden = !two;
  $("photograph").disabled = !own;
  $("photograph-note").textContent = own ? "" : "(at a view)";
  $("scale").disabled = !sitesOn().length;
  $("gain-row").hidden = !two || $("as").value !== "difference";
}

function download(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

function save() {
  $("picture").toBlob((blob) => download(blob, `${scene.name}-${layer()}.png`), "image/png");
}

async function downloadPath() {
  const [width, height] = size(SHARP);
  const q = new URLSearchParams({ width, height, fps: 15, pose: pose(camera).join(","), fov: camera.fov });
  try {
    const reply = await get(`path?${q}`, { method: "POST", body: JSON.stringify(path) });
    download(await reply.blob(), "camera_path.json");
    status(`camera_path.json has ${path.length} cameras: augnerf render RUN --cameras camera_path.json`);
  } catch (error) {
    status(error.message, true);
  }
}

// ---- Start and state -----------------------------------------------------------------------------------------------

function option(select, value, text) {
  const made = document.createElement("option");
  [made.value, made.textContent] = [value, text];
  select.append(made);
}

function choice(parent, type, value, checked, onchange) {
  const label = document.createElement("label"), input = document.createElement("input");
  Object.assign(input, { type, name: parent.id, value, checked });
  input.addEventListener("change", onchange);
  label.append(input, value);
  parent.append(label);
}

function buildSites() {
  const { sites, attacked } = runs[0];
  $("sites").replaceChildren();
  sites.forEach((site) => choice($("sites"), "checkbox", site, false, () => { rows(); changed(true); showRay(); }));
  $("attack").hidden = sites.length === 0;
  $("attack-note").textContent = attacked
    ? "The deltas that the run's own search finds. From a photograph's camera they raise its error; elsewhere they lead away from the clean pass."
    : "This run was not trained with them: its settings say which sets Aug-NeRF would have.";
}

async function follow() {
  try {
    const before = runs.map((run) => run.step);
    const hadSites = runs[0] && runs[0].sites.length;
    runs = (await (await get("state", { signal: AbortSignal.timeout(ANSWER) })).json()).runs;
    $("runs").replaceChildren(...runs.map((run) => {
      const line = document.createElement("p");
      const skipped = run.occupied === null ? "" : `; ${Math.round(100 * (1 - run.occupied))} % of space is empty and skipped`;
      line.textContent = `${run.label}: ${run.method}, ${run.step === null ? "no step yet" : `step ${run.step} of ${run.steps}`}${skipped}`;
      return line;
    }));
    if (camera === null && runs.every((run) => run.step !== null)) begin();
    else if (camera && runs.some((run, i) => run.step !== before[i])) {
      if (!hadSites && runs[0].sites.length) buildSites();
      // A picture that is being made is finished first: a training may go on faster than pictures are made.
      if (busy) outdated = true; else changed(true);
    }
  } catch { /* said by `lost` */ }
  setTimeout(follow, 2000);
}

function begin() {
  buildSites();
  option($("beside"), "", "nothing");
  runs.slice(1).forEach((run, i) => option($("beside"), `run${i + 1}`, run.label));
  if (runs[0].sites.length) option($("beside"), "attack", "the worst case");
  if (runs.length > 1) $("beside").value = "run1";
  jump(scene.views[0].id);
}

async function start() {
  status("Loading …");
  scene = await (await get("scene")).json();
  $("scene").textContent = scene.name;
  document.title = `${scene.name} – augnerf view`;
  scene.layers.forEach((name, i) => choice($("layers"), "radio", name, i === 0, () => changed(true)));
  option($("views"), "", "(the camera has left it)");
  scene.views.forEach((view) => option($("views"), view.id, `${view.split} ${view.name}`));
  listen();
  await follow();
  if (camera === null) status("The training has not made a step yet.");
}

start().catch((error) => status(error.message, true));
