"use strict";
const data = JSON.parse(document.getElementById("cs-data").textContent);
const find = (selector) => document.querySelector(selector);
const svg = find(".animation svg"), original = find(".original"), slider = find(".time"), button = find("[data-do=play]");
let now = 0, playing = !matchMedia("(prefers-reduced-motion: reduce)").matches, before = null;
svg.pauseAnimations();

// The last entry that has begun.
function latest(entries, time) {
  let place = 0;
  while (place + 1 < entries.length && entries[place + 1].begin <= time + 1e-6) place++;
  return place;
}

function show(time) {
  now = Math.min(Math.max(time, 0), data.duration - 1e-4);
  svg.setCurrentTime(now);
  const shown = data.pictures[latest(data.pictures, now)];
  if (original.src !== shown.url) original.src = shown.url;
  const frame = latest(data.frames, now), level = data.frames[frame].psnr_db;
  find(".frame").textContent = `frame ${frame + 1} of ${data.frames.length}`;
  find(".level").textContent = level === null ? "identical" : `${level.toFixed(2)} dB`;
  find(".now").textContent = `${now.toFixed(2)} s`;
  slider.value = now;
}

function play(on) {
  playing = on;
  before = null;
  button.textContent = on ? "Pause" : "Play";
}

function step(by) {
  play(false);
  const frames = data.frames, next = (latest(frames, now) + by + frames.length) % frames.length;
  show(frames[next].begin);
}

function tick(at) {
  if (playing) {
    if (before !== null) show((now + (at - before) / 1000 * Number(find(".speed").value)) % data.duration);
    before = at;
  }
  requestAnimationFrame(tick);
}

button.addEventListener("click", () => play(!playing));
find("[data-do=back]").addEventListener("click", () => step(-1));
find("[data-do=on]").addEventListener("click", () => step(1));
slider.addEventListener("input", () => { play(false); show(Number(slider.value)); });
document.addEventListener("keydown", (event) => {
  if (event.target.closest("input, select, button")) return;
  if (event.key === " ") play(!playing);
  else if (event.key === "ArrowLeft") step(-1);
  else if (event.key === "ArrowRight") step(1);
  else return;
  event.preventDefault();
});
play(playing);
show(0);
requestAnimationFrame(tick);
