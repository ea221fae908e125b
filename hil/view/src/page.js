"use strict";
const byId = id => document.getElementById(id);
const about = JSON.parse(byId("about").textContent);
const token = new URLSearchParams(location.search).get("token");
const delays = [];
const MOST_DELAYS = 500;

function address(path, more) {
  const query = new URLSearchParams({ token, port: byId("port").value, field: byId("field").value, ...more });
  return `${path}?${query}`;
}

function show(parts) {
  for (const [id, text] of Object.entries(parts)) {
    const place = byId(id);
    if (place.querySelector("svg[data-axis]") && place.matches(":active")) continue; /* a span of it is being selected */
    const held = place.contains(document.activeElement);
    place.innerHTML = text;
    if (held) place.querySelector("[tabindex], svg")?.focus();
  }
  dispatchEvent(new Event("redrawn"));
  if (parts.numbers) byId("air").hidden = false;
  if (parts.links) byId("links-heading").hidden = false;
}

function state(text, good) {
  byId("state").textContent = text;
  byId("state").className = good ? "badge good" : "badge bad";
}

function options(select, values) {
  select.replaceChildren(...values.map(value => new Option(value)));
}

function chooseFields() {
  const port = about.ports.find(each => each.name === byId("port").value);
  options(byId("field"), port ? port.fields : []);
}

/* From a port's write to the frame that the browser has drawn after it. */
function measure(written) {
  requestAnimationFrame(() => setTimeout(() => {
    delays.push(Date.now() - written);
    if (delays.length > MOST_DELAYS) delays.shift();
    const sorted = [...delays].sort((a, b) => a - b);
    const p95 = sorted[Math.floor(0.95 * (sorted.length - 1))];
    byId("delay").textContent = `from the write of a port to the screen: ${p95.toFixed(0)} ms or less, 95 of 100 times`;
    byId("delay").dataset.p95 = p95;
  }));
}

let events = null;
function listen() {
  if (events) events.close();
  events = new EventSource(address("events"));
  events.onopen = () => state("live", true);
  events.onerror = () => state("not connected", false);
  events.onmessage = message => {
    const { parts, written_ms: written } = JSON.parse(message.data);
    show(parts);
    if (parts.note !== undefined) state(parts.note ? "not heard" : "live", !parts.note);
    if (written) measure(written);
  };
}

async function order(request) {
  byId("answer").textContent = "…";
  try {
    const options = { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(request) };
    const reply = await fetch(address("order"), options);
    const said = reply.ok ? await reply.json() : { refused: await reply.text() };
    byId("answer").textContent = said.done || said.refused;
    byId("answer").className = said.done ? "good" : "bad";
  } catch (error) {
    byId("answer").textContent = "there is no answer: " + error.message;
    byId("answer").className = "bad";
  }
}

function prepareOrders() {
  byId("orders").hidden = false;
  options(byId("partition"), about.partitions);
  options(byId("schedule"), about.schedules);
  options(byId("faults"), about.faults);
  options(byId("targets"), [...about.partitions, ...about.ports.map(each => each.name), "dispatcher"]);
  for (const form of document.forms) form.addEventListener("submit", event => event.preventDefault());
  byId("act").addEventListener("click", event => {
    const ask = event.target.dataset.ask;
    if (ask) order({ ask, partition: byId("partition").value });
  });
  byId("inject").addEventListener("submit", () => order({ ask: "inject", target: byId("target").value, fault: byId("fault").value }));
  byId("change").addEventListener("submit", () => order({ ask: "schedule", name: byId("schedule").value }));
}

let playing = null;
let asked = 0;
let busy = false;
let wanted = null;
async function showTime() {
  const time = Number(byId("time").value);
  byId("shown-time").textContent = `${time.toFixed(1)} s`;
  wanted = time;
  if (busy) return;
  busy = true;
  try {
    while (wanted !== null) {
      const t = wanted;
      wanted = null;
      const reply = await fetch(address("at", { t }));
      if (!reply.ok) throw new Error(await reply.text());
      show((await reply.json()).parts);
      state("recorded", true);
      asked += 1;
    }
  } catch (error) {
    state("not connected", false);
  } finally {
    busy = false;
  }
}

function play() {
  if (playing !== null) {
    clearInterval(playing);
    playing = null;
    byId("play").textContent = "Play";
    return;
  }
  const slider = byId("time");
  if (Number(slider.value) >= Number(slider.max)) slider.value = slider.min;
  byId("play").textContent = "Pause";
  let last = performance.now();
  let time = Number(slider.value);
  playing = setInterval(() => {
    const now = performance.now();
    if (Math.abs(time - Number(slider.value)) > 0.2) time = Number(slider.value);
    time += Number(byId("speed").value) * (now - last) / 1000;
    last = now;
    slider.value = time;
    showTime();
    if (time >= Number(slider.max)) play();
  }, 100);
}

function preparePlayer() {
  byId("player").hidden = false;
  const slider = byId("time");
  slider.min = about.from_s;
  slider.max = about.to_s;
  slider.value = about.from_s;
  slider.addEventListener("input", showTime);
  byId("play").addEventListener("click", play);
  addEventListener("keydown", event => {
    if (event.key === " " && event.target === document.body) {
      event.preventDefault();
      play();
    }
  });
}

options(byId("port"), about.ports.map(each => each.name));
const preferred = about.ports.find(each => each.fields.includes("euler_rad"));
if (preferred) byId("port").value = preferred.name;
chooseFields();
if (preferred) byId("field").value = "euler_rad";
const refresh = about.live ? listen : showTime;
byId("port").addEventListener("change", () => { chooseFields(); refresh(); });
byId("field").addEventListener("change", refresh);
if (about.live) prepareOrders(); else preparePlayer();
refresh();
