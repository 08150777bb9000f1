// The map and the table of cells, and what listens to keys, pointer and address.
// Cells: their place in the columns is seed * contents + content -------------------------------------------------

let seeds, contents, columns, quantities, normal95, mostPulseEffect, cellCount; // seeds are texts: a number of 63 bits would not be exact here
let chosen = []; // places that the filters let through
let isChosen = new Uint8Array(0);
let cursor = 0; // place that arrow keys move
let opened = null; // place whose details are shown
let order = { name: "seed", rising: true };
let page = 0;
const ROWS = 20;

const seedOf = (place) => seeds[Math.floor(place / contents.length)];
const contentOf = (place) => contents[place % contents.length];
const statusOf = (place) => columns.status[place] || "not computed";
const outcomes = () => [...new Set(Array.from({ length: cellCount }, (_, place) => statusOf(place)))].sort();
const link = (place) => `#seed=${seedOf(place)}&content=${contentOf(place)}`;
const isLoud = (place) => columns.pulse_effect?.[place] > mostPulseEffect; // its velocity depends on the pulse
const labelOf = (place) => `seed ${seedOf(place)} at ${contentOf(place)} %`;
function valueOf(name, place) {
  if (name === "seed") return Number(seedOf(place)); // to sort by; equal ones stay in their order
  if (name === "content") return contentOf(place);
  return name === "status" ? statusOf(place) : columns[name][place];
}

function readFilters() {
  const text = byId("seeds").value.trim();
  const ranges = text.replace(/\s*[-–]\s*/g, "-").split(/[\s,;]+/).map((part) => part.match(/^(\d+)(?:[-–](\d+))?$/)).filter(Boolean);
  const content = byId("content").value;
  const outcome = byId("outcome").value;
  const [least, most] = ["least", "most"].map((id) => (byId(id).value === "" ? null : Number(byId(id).value)));
  chosen = [];
  isChosen = new Uint8Array(cellCount);
  for (let place = 0; place < cellCount; place++) {
    const seed = seedOf(place);
    const vs = columns.vs[place];
    const isWanted = ([, from, to]) => seed === from || seed === to || (to && (seed - from) * (seed - to) < 0);
    if (text && !ranges.some(isWanted)) continue;
    if (content !== "" && contentOf(place) !== Number(content)) continue;
    if (outcome !== "" && statusOf(place) !== outcome) continue;
    if (least !== null && !(vs >= least && vs !== null)) continue;
    if (most !== null && !(vs <= most && vs !== null)) continue;
    chosen.push(place);
    isChosen[place] = 1;
  }
  sortRows();
  drawMap();
}

// Table --------------------------------------------------------------------------------------------------------

const SHOWN = ["seed", "content", "status", "vs", "vs_peak", "vs_first_arrival", "vs_cross_correlation"];
const SHOWN_LATER = ["vs_error", "effective_vs", "pulse_effect", "path_normalized_connectivity", "seconds", "reason"];
const HEADINGS = {
  seed: "seed",
  content: "content (%)",
  status: "outcome",
  vs: "Vs (m/s)",
  vs_peak: "by peak",
  vs_first_arrival: "by first arrival",
  vs_cross_correlation: "by correlation",
  vs_error: "standard error (%)",
  effective_vs: "effective Vs (m/s)",
  pulse_effect: "effect of the pulse (%)",
  path_normalized_connectivity: "C_d,n",
  seconds: "time (s)",
  reason: "reason",
};
const IN_PERCENT = new Set(["vs_error", "pulse_effect"]);
let shownColumns = [];

function sortRows() {
  const { name, rising } = order;
  const keys = new Map(chosen.map((place) => [place, valueOf(name, place)]));
  const lacks = (value) => value === null || value === "";
  chosen.sort((one, other) => {
    const [a, b] = [keys.get(one), keys.get(other)];
    if (lacks(a) || lacks(b)) return lacks(a) - lacks(b) || one - other; // what is missing comes last
    return ((a > b) - (a < b)) * (rising ? 1 : -1) || one - other;
  });
  showRows();
}
function showRows() {
  const head = shownColumns.map((name) => {
    const sorted = order.name === name ? (order.rising ? "ascending" : "descending") : "none";
    const arrow = { ascending: " ▲", descending: " ▼", none: "" }[sorted];
    return `<th scope="col" aria-sort="${sorted}"><button type="button" data-sort="${name}">${HEADINGS[name]}${arrow}</button></th>`;
  });
  const focused = document.activeElement?.dataset?.sort;
  const followed = byId("cells").tBodies[0].contains(document.activeElement) && document.activeElement.getAttribute("href");
  byId("cells").tHead.innerHTML = `<tr>${head.join("")}</tr>`;
  if (focused) byId("cells").querySelector(`[data-sort="${focused}"]`).focus();
  const rows = chosen.slice(page * ROWS, (page + 1) * ROWS).map((place) => {
    const values = shownColumns.map((name) => {
      const mark = name === "pulse_effect" && isLoud(place) ? " ~" : "";
      const value = valueOf(name, place);
      const shown = IN_PERCENT.has(name) && value !== null ? number(100 * value, 2) : number(value);
      const text = name === "seed" ? seedOf(place) : escape(shown) + mark;
      return name === "seed" ? `<td><a href="${link(place)}" aria-label="${labelOf(place)}">${text}</a></td>` : `<td>${text}</td>`;
    });
    return `<tr>${values.join("")}</tr>`;
  });
  byId("cells").tBodies[0].innerHTML = rows.join("") || `<tr><td colspan="${shownColumns.length}">No cell is like this.</td></tr>`;
  if (followed) byId("cells").querySelector(`[href="${followed}"]`)?.focus({ preventScroll: true });
  const pages = Math.max(1, Math.ceil(chosen.length / ROWS));
  page = Math.min(page, pages - 1);
  const count = chosen.length.toLocaleString("en");
  byId("count").textContent = `${count} of ${cellCount.toLocaleString("en")} cells. A heading sorts, a seed opens its cell.`;
  byId("pages").textContent = `page ${page + 1} of ${pages.toLocaleString("en")}`;
  byId("back").disabled = page === 0;
  byId("on").disabled = page + 1 >= pages;
}

// Map ----------------------------------------------------------------------------------------------------------

const LEFT = 60;
const BOTTOM = 42;
const EDGE = 8;
let cellWidth, cellHeight, shades;

/** Colours of all cells for the chosen quantity, with what the legend has to say. */
function shade() {
  const name = byId("colour").value;
  if (name === "status") {
    const names = outcomes();
    const colours = names.map((status) => (status === "not computed" ? null : NAMED[names.indexOf(status) % NAMED.length]));
    shades = { colour: (place) => colours[names.indexOf(statusOf(place))], names, colours, label: "outcome" };
    return;
  }
  const relative = name === "deviation";
  const source = columns[relative ? "vs" : name];
  let values = source;
  if (relative) {
    const means = contents.map((_, at) => {
      const known = seeds.map((_, seed) => source[seed * contents.length + at]).filter((value) => value !== null);
      return known.reduce((sum, value) => sum + value, 0) / known.length;
    });
    values = source.map((value, place) => (value === null ? null : 100 * (value / means[place % contents.length] - 1)));
  }
  let [low, high] = [Infinity, -Infinity];
  for (const value of values) if (value !== null) [low, high] = [Math.min(low, value), Math.max(high, value)];
  if (relative) [low, high] = [-Math.max(-low, high), Math.max(-low, high)];
  const known = quantities.find((quantity) => quantity.name === name);
  const isLog = low > 0 && high > 4 * low; // otherwise the lower half would have one colour
  const share = (value) => (isLog ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low || 1));
  shades = {
    values,
    low,
    high,
    middle: isLog ? Math.sqrt(low * high) : null,
    stops: relative ? DIVERGING : RISING,
    label: relative ? "Vs against the mean of its content" : name === "vs" ? "Vs" : known.meaning,
    unit: relative ? "%" : known.unit,
    colour: (place) => (values[place] === null ? null : mix(shades.stops, share(values[place]))),
  };
}
function showScale() {
  if (shades.names) {
    const keys = shades.names.map((name, at) => `<span>${swatch(shades.colours[at] ?? "none")}${escape(number(name))}</span>`);
    byId("scale").innerHTML = keys.join("");
    return;
  }
  const [low, high] = [shades.low, shades.high].map((value) => escape(withUnit(Number.isFinite(value) ? value : null, shades.unit)));
  const stops = shades.stops.map((stop) => `#${stop}`).join();
  byId("scale").innerHTML =
    `<span>${escape(shades.label)}:</span><span>${low}</span>` +
    `<span role="presentation" style="width:12rem;height:.9rem;background:linear-gradient(90deg,${stops})"></span><span>${high}</span>` +
    `${shades.middle === null ? "" : `<span>(logarithmic; middle ${escape(withUnit(shades.middle, shades.unit))})</span>`}${key("wash", "without a number (×) or not computed")}`;
}
function layOutMap() {
  const room = byId("viewport").clientWidth - LEFT - EDGE;
  cellWidth = clamp(room / seeds.length, 8, 44);
  cellHeight = contents.length > 40 ? 12 : 24;
  byId("heat").style.setProperty("--widest", `${LEFT + seeds.length * 44 + EDGE + 2}px`);
  const extent = byId("extent").style;
  extent.width = `${Math.max(LEFT + seeds.length * cellWidth + EDGE, 1)}px`;
  extent.height = `${EDGE + contents.length * cellHeight + BOTTOM}px`;
  drawMap();
}
function corner(place) {
  const viewport = byId("viewport");
  return [
    LEFT + Math.floor(place / contents.length) * cellWidth - viewport.scrollLeft,
    EDGE + (contents.length - 1 - (place % contents.length)) * cellHeight - viewport.scrollTop,
  ];
}
function drawMap() {
  const viewport = byId("viewport");
  const [width, height] = [viewport.clientWidth, viewport.clientHeight];
  if (!width || !shades) return;
  const brush = context(byId("map"), width, height);
  const [ink, quiet, wash] = ["ink", "quiet", "wash"].map(paint);
  const first = Math.max(0, Math.floor(viewport.scrollLeft / cellWidth));
  const last = Math.min(seeds.length, Math.ceil((viewport.scrollLeft + width - LEFT) / cellWidth));
  brush.save();
  brush.beginPath();
  brush.rect(LEFT, 0, width - LEFT, height - BOTTOM);
  brush.clip();
  const outline = (place, colour, thickness) => {
    const [x, y] = corner(place);
    brush.strokeStyle = colour;
    brush.lineWidth = thickness;
    brush.strokeRect(x + 0.5, y + 0.5, cellWidth - 1, cellHeight - 1);
  };
  for (let place = first * contents.length; place < last * contents.length; place++) {
    const [x, y] = corner(place);
    if (y > height || y < -cellHeight) continue;
    const colour = shades.colour(place);
    brush.globalAlpha = isChosen[place] ? 1 : 0.12;
    brush.fillStyle = colour ?? wash;
    brush.fillRect(x, y, cellWidth - 1, cellHeight - 1);
    if (colour === null && columns.status[place]) {
      const [middle, centre, arm] = [x + cellWidth / 2 - 0.5, y + cellHeight / 2 - 0.5, Math.min(cellWidth, 12) / 3];
      brush.strokeStyle = ink;
      brush.lineWidth = 1.2;
      brush.beginPath();
      for (const side of [-1, 1]) {
        brush.moveTo(middle - arm, centre - side * arm);
        brush.lineTo(middle + arm, centre + side * arm);
      }
      brush.stroke();
    }
  }
  brush.globalAlpha = 1;
  if (opened !== null) outline(opened, ink, 3);
  if (document.activeElement === byId("map")) outline(cursor, paint("accent"), 3);
  brush.restore();
  brush.fillStyle = ink;
  brush.strokeStyle = quiet;
  brush.lineWidth = 1;
  brush.textAlign = "center";
  brush.textBaseline = "top";
  const everySeed = Math.ceil((8 * String(seeds.at(-1)).length + 16) / cellWidth);
  for (let at = Math.ceil(first / everySeed) * everySeed; at < last; at += everySeed) {
    const x = corner(at * contents.length)[0] + cellWidth / 2;
    if (x > LEFT - 2 && x < width - 8) brush.fillText(seeds[at], x, height - BOTTOM + 6);
  }
  brush.textAlign = "right";
  brush.textBaseline = "middle";
  const everyContent = Math.ceil(15 / cellHeight);
  for (let at = 0; at < contents.length; at += everyContent) {
    const y = corner(at)[1] + cellHeight / 2;
    if (y > 4 && y < height - BOTTOM) brush.fillText(contents[at], LEFT - 6, y);
  }
  brush.textAlign = "center";
  brush.fillText("seed", (LEFT + Math.min(width, LEFT + seeds.length * cellWidth)) / 2, height - 10);
  brush.rotate(-Math.PI / 2);
  const title = ["calcite content (%)", "content (%)", "%"].find((text) => brush.measureText(text).width < height - BOTTOM) ?? "%";
  brush.fillText(title, -(height - BOTTOM) / 2, 10);
}
function placeAt(event) {
  const box = byId("map").getBoundingClientRect();
  const viewport = byId("viewport");
  const [x, y] = [event.clientX - box.left, event.clientY - box.top];
  if (x < LEFT || y > box.height - BOTTOM) return null;
  const seed = Math.floor((x - LEFT + viewport.scrollLeft) / cellWidth);
  const content = contents.length - 1 - Math.floor((y - EDGE + viewport.scrollTop) / cellHeight);
  return seeds[seed] !== undefined && contents[content] !== undefined ? seed * contents.length + content : null;
}
function showTip(place) {
  const tip = byId("tip");
  if (place === null) {
    tip.textContent = "";
    return;
  }
  const lines = [labelOf(place), `Vs ${withUnit(columns.vs[place], "m/s")}${isLoud(place) ? " ~" : ""}`];
  if (columns.vs[place] === null) lines[1] = `${number(statusOf(place))}${columns.reason[place] ? `: ${columns.reason[place]}` : ""}`;
  if (shades.values && byId("colour").value !== "vs") lines.push(`${shades.label}: ${withUnit(shades.values[place], shades.unit)}`);
  tip.textContent = lines.join("\n");
  const [x, y] = corner(place);
  const room = byId("heat").clientWidth - tip.offsetWidth;
  tip.style.left = `${clamp(x + cellWidth / 2 - tip.offsetWidth / 2, 0, Math.max(room, 0))}px`;
  tip.style.top = `${y - tip.offsetHeight - 6 > -40 ? y - tip.offsetHeight - 6 : y + cellHeight + 6}px`;
}
function moveCursor(event) {
  const across = { ArrowLeft: -1, ArrowRight: 1 }[event.key] ?? 0;
  const up = { ArrowUp: 1, ArrowDown: -1 }[event.key] ?? 0;
  if (event.key === "Enter" || event.key === " ") {
    event.preventDefault();
    location.hash = link(cursor);
    return;
  }
  if (event.key === "Escape") showTip(null);
  if (!across && !up) return;
  event.preventDefault();
  const seed = clamp(Math.floor(cursor / contents.length) + across, 0, seeds.length - 1);
  cursor = seed * contents.length + clamp((cursor % contents.length) + up, 0, contents.length - 1);
  const viewport = byId("viewport");
  const [x, y] = corner(cursor);
  viewport.scrollLeft += Math.min(0, x - LEFT) + Math.max(0, x + cellWidth + EDGE - viewport.clientWidth);
  viewport.scrollTop += Math.min(0, y - EDGE) + Math.max(0, y + cellHeight + BOTTOM - viewport.clientHeight);
  drawMap();
  showTip(cursor);
}

// Wiring -------------------------------------------------------------------------------------------------------

function redraw() {
  if (!columns) return;
  drawMap();
  drawDetails();
}
function followLink(event) {
  const wanted = new URLSearchParams(location.hash.slice(1));
  const [seed, content] = [seeds.indexOf(wanted.get("seed")), contents.indexOf(Number(wanted.get("content")))];
  if (!wanted.has("seed") || seed < 0 || content < 0) return;
  openCell(seed * contents.length + content).then(() => {
    byId("cell").scrollIntoView({ block: "start" });
    if (event) byId("cell").focus({ preventScroll: true });
  });
}
function option(value, text) {
  return `<option value="${escape(value)}">${escape(text)}</option>`;
}
/** Take over the cells of a campaign, and what the controls offer of them; what is chosen stays as far as it is there. */
function take(records) {
  ({ seeds, contents, columns, quantities, normal95, mostPulseEffect } = records);
  cellCount = seeds.length * contents.length;
  cursor = Math.min(cursor, cellCount - 1);
  const there = (name) => name in HEADINGS && ["seed", "content", "status", "vs"].concat(quantities.map((one) => one.name)).includes(name);
  const repeats = (name) => name === "vs_peak" && columns.vs_peak?.every((value, place) => value === columns.vs[place]);
  shownColumns = [...SHOWN, ...SHOWN_LATER].filter((name) => there(name) && !repeats(name));
  const numeric = quantities.filter(({ name, kind }) => kind !== "text" && name !== "vs");
  offer("colour",
    option("vs", "Vs") + option("deviation", "Vs against the mean of its content") + option("status", "outcome") +
    numeric.map(({ name, meaning }) => option(name, meaning)).join(""));
  offer("content", option("", "all") + contents.map((content) => option(content, `${content} %`)).join(""));
  refresh();
  layOutMap();
}
function offer(id, options) {
  const wanted = byId(id).value;
  if (byId(id).innerHTML === options) return;
  byId(id).innerHTML = options;
  if ([...byId(id).options].some(({ value }) => value === wanted)) byId(id).value = wanted;
}
/** Show what is in the columns now. */
function refresh() {
  offer("outcome", option("", "all") + outcomes().map((outcome) => option(outcome, number(outcome))).join(""));
  refreshColours();
  readFilters();
}
function refreshColours() {
  shade();
  showScale();
  byId("map").setAttribute("aria-label", `Map of ${shades.label} over ${seeds.length} seeds (across) and ${contents.length} contents (upwards). Arrow keys move, Enter opens a cell.`);
  drawMap();
}
function start(records) {
  take(records);
  byId("filters").addEventListener("input", (event) => {
    if (event.target.id === "colour") return refreshColours();
    page = 0;
    readFilters();
  });
  byId("filters").addEventListener("submit", (event) => event.preventDefault());
  byId("filters").addEventListener("reset", () => setTimeout(() => [(page = 0), refreshColours(), readFilters()]));
  byId("cells").addEventListener("click", (event) => {
    const name = event.target.dataset.sort;
    if (!name) return;
    order = { name, rising: order.name === name ? !order.rising : true };
    page = 0;
    sortRows();
  });
  byId("cell").addEventListener("click", (event) => {
    if (event.target.id === "forces") {
      showsForces = event.target.checked;
      drawSample();
      byId("forces").focus();
    }
    if (!event.target.dataset.zoom) return;
    zoom = clamp(zoom * Number(event.target.dataset.zoom), 1, 4);
    const pressed = event.target.dataset.zoom;
    drawSample();
    byId("cell").querySelector(`[data-zoom="${pressed}"]`)?.focus();
  });
  for (const [id, step] of [["back", -1], ["on", 1]]) {
    byId(id).addEventListener("click", () => {
      page += step;
      showRows();
    });
  }
  const map = byId("map");
  map.addEventListener("pointermove", (event) => showTip(placeAt(event)));
  map.addEventListener("pointerleave", () => showTip(null));
  map.addEventListener("keydown", moveCursor);
  map.addEventListener("focus", drawMap);
  map.addEventListener("blur", () => [showTip(null), drawMap()]);
  map.addEventListener("click", (event) => {
    const place = placeAt(event);
    if (place !== null) location.hash = link(place);
  });
  byId("viewport").addEventListener("scroll", () => [showTip(null), drawMap()]);
  let width = 0;
  new ResizeObserver(() => {
    if (byId("viewport").clientWidth === width) return;
    width = byId("viewport").clientWidth;
    layOutMap();
    drawDetails();
  }).observe(byId("viewport"));
  addEventListener("hashchange", followLink);
  followLink();
}
