"use strict";
// The map and the table of cells, and a closer look at one. Data are in <script> elements of this page: JSON,
// compressed, in base64; see cell_data.py.
(() => {
  const byId = (id) => document.getElementById(id);
  const escape = (text) => String(text).replace(/[&<>"]/g, (sign) => `&#${sign.charCodeAt(0)};`);
  const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
  const METHODS = ["peak", "first_arrival", "cross_correlation"];
  const MISSING = "–";

  const cache = new Map();
  function load(id) {
    if (!cache.has(id)) cache.set(id, decompress(byId(id).textContent));
    return cache.get(id);
  }
  async function decompress(text) {
    const bytes = Uint8Array.from(atob(text), (sign) => sign.charCodeAt(0));
    return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"))).json();
  }
  function sums(steps) {
    let sum = 0;
    return steps.map((step) => (sum += step));
  }

  // Numbers and colours ------------------------------------------------------------------------------------------

  function number(value, digits = 4) {
    if (value === null || value === undefined || value === "") return MISSING;
    if (typeof value !== "number") return String(value).replace("_", " ");
    const size = Math.abs(value);
    const exact = Number.isInteger(value) && size < 1e7;
    let text = String(exact ? value : Number(value.toPrecision(digits)));
    if (!exact && (size < 1e-3 || size >= 1e6)) text = value.toExponential(digits - 1);
    text = text.replace(/\.?0*e\+?(-?)(\d+)/, (_, sign, digits) => {
      return ` × 10${sign ? "⁻" : ""}${[...digits].map((digit) => "⁰¹²³⁴⁵⁶⁷⁸⁹"[digit]).join("")}`;
    });
    return text.replace(/^-/, "−");
  }
  const withUnit = (value, unit, digits = 4) => number(value, digits) + (typeof value === "number" && unit ? ` ${unit}` : "");

  const probe = document.body.appendChild(Object.assign(document.createElement("span"), { hidden: true }));
  /** A colour of the style sheet as a canvas takes it. */
  function paint(name) {
    probe.style.color = `var(--${name})`;
    return getComputedStyle(probe).color;
  }
  const RISING = ["440154", "482878", "3e4989", "31688e", "26828e", "1f9e89", "35b779", "6ece58", "b5de2b", "fde725"];
  const DIVERGING = ["2166ac", "67a9cf", "d1e5f0", "f7f7f7", "fddbc7", "ef8a62", "b2182b"];
  const NAMED = ["#56b4e9", "#d55e00", "#e69f00", "#cc79a7", "#009e73", "#f0e442", "#0072b2", "#999999"];
  function mix(stops, share) {
    const place = clamp(share, 0, 1) * (stops.length - 1);
    const low = Math.min(Math.floor(place), stops.length - 2);
    const part = (stop, at) => parseInt(stops[stop].slice(at, at + 2), 16);
    const tones = [0, 2, 4].map((at) => Math.round(part(low, at) + (place - low) * (part(low + 1, at) - part(low, at))));
    return `rgb(${tones})`;
  }
  function ticks(low, high, most) {
    const raw = (high - low) / Math.max(most, 1) || 1;
    const power = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].find((factor) => factor * power >= raw) * power;
    const found = [];
    for (let place = Math.ceil(low / step); place * step <= high + 1e-9 * step; place++) found.push(place * step);
    return found;
  }
  /** A canvas of a size in the page's pixels, sharp on every screen. */
  function context(canvas, width, height) {
    const ratio = Math.min(devicePixelRatio || 1, 2);
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    canvas.style.width = `${width}px`;
    canvas.style.height = `${height}px`;
    const drawn = canvas.getContext("2d");
    drawn.scale(ratio, ratio);
    drawn.font = "12px system-ui, sans-serif";
    return drawn;
  }

  // Theme --------------------------------------------------------------------------------------------------------

  const root = document.documentElement;
  const prefersDark = matchMedia("(prefers-color-scheme: dark)");
  let remembered = null;
  try {
    remembered = localStorage.getItem("calcidem-theme");
  } catch {
    // Pages opened from disk may have no storage; the switch then lasts as long as the page.
  }
  const isDark = () => (remembered ? remembered === "dark" : prefersDark.matches);
  function showTheme() {
    root.style.colorScheme = isDark() ? "dark" : "light";
    root.toggleAttribute("data-dark", isDark());
    byId("theme").textContent = isDark() ? "light" : "dark";
    byId("theme").setAttribute("aria-label", `change to ${isDark() ? "light" : "dark"} colours`);
  }
  byId("theme").hidden = false;
  byId("theme").addEventListener("click", () => {
    remembered = isDark() ? "light" : "dark";
    try {
      localStorage.setItem("calcidem-theme", remembered);
    } catch {
      // see above
    }
    showTheme();
    redraw();
  });
  prefersDark.addEventListener("change", () => {
    showTheme();
    redraw();
  });
  showTheme();

  // Cells: their place in the columns is seed * contents + content -------------------------------------------------

  let seeds, contents, columns, quantities, cellCount;
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
  const link = (place) => `#seed=${seedOf(place)}&content=${contentOf(place)}`;
  const labelOf = (place) => `seed ${seedOf(place)} at ${contentOf(place)} %`;
  function valueOf(name, place) {
    if (name === "seed") return seedOf(place);
    if (name === "content") return contentOf(place);
    return name === "status" ? statusOf(place) : columns[name][place];
  }

  function readFilters() {
    const text = byId("seeds").value.trim();
    const ranges = text.split(/[\s,;]+/).map((part) => part.match(/^(\d+)(?:[-–](\d+))?$/)).filter(Boolean);
    const content = byId("content").value;
    const outcome = byId("outcome").value;
    const [least, most] = ["least", "most"].map((id) => (byId(id).value === "" ? null : Number(byId(id).value)));
    chosen = [];
    isChosen = new Uint8Array(cellCount);
    for (let place = 0; place < cellCount; place++) {
      const seed = seedOf(place);
      const vs = columns.vs[place];
      if (text && !ranges.some(([, from, to]) => seed >= Number(from) && seed <= Number(to ?? from))) continue;
      if (content !== "" && contentOf(place) !== Number(content)) continue;
      if (outcome !== "" && statusOf(place) !== outcome) continue;
      if (least !== null && !(vs >= least && vs !== null)) continue;
      if (most !== null && !(vs <= most && vs !== null)) continue;
      chosen.push(place);
      isChosen[place] = 1;
    }
    page = 0;
    sortRows();
    drawMap();
  }

  // Table --------------------------------------------------------------------------------------------------------

  const SHOWN = ["seed", "content", "status", "vs", "vs_peak", "vs_first_arrival", "vs_cross_correlation"];
  const SHOWN_LATER = ["error_bound", "path_normalized_connectivity", "seconds", "reason"];
  const HEADINGS = {
    seed: "seed",
    content: "content (%)",
    status: "outcome",
    vs: "Vs (m/s)",
    vs_peak: "by peak",
    vs_first_arrival: "by first arrival",
    vs_cross_correlation: "by correlation",
    error_bound: "error bound",
    path_normalized_connectivity: "C_d,n",
    seconds: "time (s)",
    reason: "reason",
  };
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
    byId("cells").tHead.innerHTML = `<tr>${head.join("")}</tr>`;
    if (focused) byId("cells").querySelector(`[data-sort="${focused}"]`).focus();
    const rows = chosen.slice(page * ROWS, (page + 1) * ROWS).map((place) => {
      const values = shownColumns.map((name) => {
        const text = escape(number(valueOf(name, place)));
        return name === "seed" ? `<td><a href="${link(place)}" aria-label="${labelOf(place)}">${text}</a></td>` : `<td>${text}</td>`;
      });
      return `<tr>${values.join("")}</tr>`;
    });
    byId("cells").tBodies[0].innerHTML = rows.join("") || `<tr><td colspan="${shownColumns.length}">No cell is like this.</td></tr>`;
    const pages = Math.max(1, Math.ceil(chosen.length / ROWS));
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
      const names = [...new Set(Array.from({ length: cellCount }, (_, place) => statusOf(place)))].sort();
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
    shades = {
      ...{ values, low, high, stops: relative ? DIVERGING : RISING },
      label: relative ? "Vs against the mean of its content" : name === "vs" ? "Vs" : known.meaning,
      unit: relative ? "%" : known.unit,
      colour: (place) => (values[place] === null ? null : mix(shades.stops, (values[place] - low) / (high - low || 1))),
    };
  }
  function showScale() {
    const gap = `<span><span class="swatch" style="background:var(--wash)"></span>without a number (×) or not computed</span>`;
    if (shades.names) {
      const keys = shades.names.map((name, at) => {
        return `<span><span class="swatch" style="background:${shades.colours[at] ?? "none"}"></span>${escape(name.replace("_", " "))}</span>`;
      });
      byId("scale").innerHTML = keys.join("");
      return;
    }
    const [low, high] = [shades.low, shades.high].map((value) => escape(withUnit(Number.isFinite(value) ? value : null, shades.unit)));
    const stops = shades.stops.map((stop) => `#${stop}`).join();
    byId("scale").innerHTML =
      `<span>${escape(shades.label)}:</span><span>${low}</span>` +
      `<span role="presentation" style="width:12rem;height:.9rem;background:linear-gradient(90deg,${stops})"></span><span>${high}</span>${gap}`;
  }
  function layOutMap() {
    const room = byId("viewport").clientWidth - LEFT - EDGE;
    cellWidth = clamp(room / seeds.length, 8, 44);
    cellHeight = contents.length > 40 ? 12 : 24;
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
    brush.fillText("calcite content (%)", -(height - BOTTOM) / 2, 10);
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
    const lines = [labelOf(place), `Vs ${withUnit(columns.vs[place], "m/s")}`];
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

  // One cell -----------------------------------------------------------------------------------------------------

  let details = null; // what is drawn of the opened cell, to draw it again in other colours or sizes
  let zoom = 1;

  async function openCell(place) {
    opened = cursor = place;
    const id = `seed-${seedOf(place)}`;
    const cells = byId(id) ? await load(id) : [];
    const cell = cells.find((one) => one.content === contentOf(place));
    details = { signal: cell?.signal, packing: null };
    if (cell?.cement) {
      const packing = await load(`packing-${cell.packing}`);
      const kinds = new Uint8Array(packing.second.length);
      for (const one of cells) {
        if (one.packing !== cell.packing || !one.cement) continue;
        one.cement.forEach((rows, kind) => sums(rows).forEach((row) => (kinds[row] = kind)));
        if (one === cell) break;
      }
      Object.assign(details, { packing, kinds, path: sums(cell.path ?? []) });
    }
    if (opened === place) showCell(place);
  }
  function showCell(place) {
    const vs = columns.vs[place];
    const around = [
      [place - contents.length, place >= contents.length],
      [place + contents.length, place + contents.length < cellCount],
      [place - 1, place % contents.length > 0],
      [place + 1, (place + 1) % contents.length > 0],
    ].filter(([, there]) => there);
    const reason = columns.reason[place];
    const hasBlock = byId(`seed-${seedOf(place)}`);
    const absent = (what) => `<p class="quiet">${hasBlock ? `No ${what} is stored.` : "Not in this page; see above."}</p>`;
    const rows = quantities
      .map(({ name, unit, meaning }) => [meaning, withUnit(valueOf(name, place), unit, 6)])
      .filter(([, text]) => text !== MISSING);
    byId("cell").innerHTML = `
      <h3>S${labelOf(place).slice(1)}: ${vs === null ? escape(number(statusOf(place))) : `Vs = ${number(vs)} m/s`}</h3>
      ${reason ? `<p>${escape(reason)}</p>` : ""}
      <nav aria-label="Neighbours"><ul>${around.map(([at]) => `<li><a href="${link(at)}">${labelOf(at)}</a></li>`).join("")}
        <li><a href="#explore">map</a></li></ul></nav>
      <div class="columns">
        <div class="signals"><h4>Signals</h4>${details.signal ? `<div id="signal"></div>` : absent("signal")}</div>
        <div class="sample"><h4>Sample</h4>${details.packing ? `<div id="sample-keys"></div><div id="sample" tabindex="0" role="region" aria-label="Sample"><canvas role="img"></canvas></div>` : absent("cement pattern")}</div>
        <div class="record"><h4>Record</h4><div class="scroll"><table id="record"><tbody>
          ${rows.map(([meaning, text]) => `<tr><th scope="row">${escape(meaning)}</th><td>${escape(text)}</td></tr>`).join("")}
        </tbody></table></div></div>
      </div>`;
    byId("cell").hidden = false;
    drawDetails();
    drawMap();
  }
  function drawDetails() {
    if (details?.signal && byId("signal")) drawSignal(details.signal);
    if (details?.packing && byId("sample")) drawSample();
  }

  function drawSignal({ start, interval, sent, received, unit, arrivals }) {
    const host = byId("signal");
    const [width, height, left, bottom, top] = [host.clientWidth, 280, 62, 44, 10];
    const series = { sent: sums(sent.steps), received: sums(received.steps) };
    const scaleOf = (values) => Math.max(...values.map(Math.abs)) || 1;
    for (const name of ["sent", "received"]) {
      const scale = scaleOf(series[name]);
      series[name] = series[name].map((value) => value / scale);
    }
    const count = series.sent.length;
    const end = start + interval * (count - 1);
    const least = Math.min(-0.2, ...series.sent, ...series.received) - 0.05;
    const x = (time) => left + (time / end) * (width - left - 10);
    const y = (value) => top + ((1.08 - value) / (1.08 - least)) * (height - top - bottom);
    const curve = (name) => {
      const points = series[name].map((value, at) => `${x(start + interval * at).toFixed(1)},${y(value).toFixed(1)}`);
      return `<polyline points="${points.join(" ")}" fill="none" stroke="var(--${name})" stroke-width="${name === "sent" ? 1.5 : 2}"${name === "sent" ? ` stroke-dasharray="5 3"` : ""}/>`;
    };
    const across = ticks(0, end, width / 90).map((time) => {
      return `<line x1="${x(time)}" x2="${x(time)}" y1="${top}" y2="${height - bottom}" stroke="var(--line)"/><text x="${x(time)}" y="${height - bottom + 16}" text-anchor="middle">${number(time)}</text>`;
    });
    const upward = ticks(least, 1.08, 5).map((value) => {
      return `<line x1="${left}" x2="${width - 10}" y1="${y(value)}" y2="${y(value)}" stroke="var(--line)"/><text x="${left - 6}" y="${y(value) + 4}" text-anchor="end">${number(value)}</text>`;
    });
    const level = (time) => series.received[clamp(Math.round((time - start) / interval), 0, count - 1)];
    const found = METHODS.filter((method) => method in arrivals);
    const marks = found.map((method) => {
      const [at, on] = [x(arrivals[method]), y(level(arrivals[method]))];
      return `<line x1="${at}" x2="${at}" y1="${top}" y2="${height - bottom}" stroke="var(--${method})" stroke-dasharray="2 3"/><circle cx="${at}" cy="${on}" r="4.5" fill="var(--${method})" stroke="var(--wash)"/>`;
    });
    const key = (colour, text) => `<span><span class="swatch" style="background:var(--${colour})"></span>${text}</span>`;
    const said = found.map((method) => `${method.replace("_", " ")}: ${withUnit(columns[`vs_${method}`]?.[opened] ?? null, "m/s")}, ${number(arrivals[method])} ms`);
    const label = `Sent and received signal of ${labelOf(opened)} over ${number(end)} ms. ${said.join("; ") || "No arrival was read"}.`;
    host.innerHTML = `
      <svg viewBox="0 0 ${width} ${height}" tabindex="0" role="img" aria-label="${escape(label)}">
        ${across.join("")}${upward.join("")}${curve("sent")}${curve("received")}${marks.join("")}
        <line id="hair" y1="${top}" y2="${height - bottom}" stroke="var(--ink)" visibility="hidden"/>
        <text x="${(left + width) / 2}" y="${height - 8}" text-anchor="middle">time (ms)</text>
        <text transform="translate(14 ${(height - bottom) / 2}) rotate(-90)" text-anchor="middle">signal / its largest value</text>
      </svg>
      <div class="keys">${key("sent", `sent (largest ${number(sent.largest)} m/s)`)}${key("received", `received (largest ${number(received.largest)} ${unit})`)}${found.map((method, at) => key(method, said[at])).join("")}</div>
      <p class="quiet" id="reading" role="status">Values under the pointer, or with the arrow keys.</p>`;
    const svg = host.firstElementChild;
    let at = 0;
    const read = (place) => {
      at = clamp(place, 0, count - 1);
      const hair = svg.querySelector("#hair");
      for (const name of ["x1", "x2"]) hair.setAttribute(name, x(start + interval * at));
      hair.setAttribute("visibility", "visible");
      const [one, other] = [series.sent[at] * sent.largest, series.received[at] * received.largest].map((value) => Number(value.toPrecision(3)));
      byId("reading").textContent = `${number(start + interval * at)} ms: sent ${number(one)} m/s, received ${number(other)} ${unit}`;
    };
    svg.addEventListener("pointermove", (event) => {
      const box = svg.getBoundingClientRect();
      read(Math.round(((((event.clientX - box.left) / box.width) * width - left) / (x(end) - left) * end - start) / interval));
    });
    svg.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
      if (!step) return;
      event.preventDefault();
      read(at + step);
    });
  }

  function drawSample() {
    const { packing, kinds, path } = details;
    const [left, bottom, edge] = [52, 40, 14];
    byId("sample").classList.toggle("large", zoom > 1);
    const width = Math.floor(Math.min(byId("sample").clientWidth, 520) * zoom);
    const scale = (width - left - edge) / packing.width;
    const height = Math.ceil(packing.height * scale) + bottom + edge;
    const canvas = byId("sample").querySelector("canvas");
    const brush = context(canvas, width, height);
    const colours = Object.fromEntries(["ink", "quiet", "sand", "cluster", "p", "c", "way", "bare", "wash", "first_arrival", "peak"].map((name) => [name, paint(name)]));
    const at = (grain) => [left + packing.x[grain] * scale, edge + (packing.height - packing.y[grain]) * scale];
    const first = sums(packing.first);
    const inCluster = new Uint8Array(packing.x.length);
    const kindOf = new Map();
    kinds.forEach((kind, row) => {
      kindOf.set(Math.min(first[row], packing.second[row]) * packing.x.length + Math.max(first[row], packing.second[row]), kind);
      if (kind === 2) inCluster[first[row]] = inCluster[packing.second[row]] = 1;
    });
    for (const clustered of [0, 1]) {
      brush.fillStyle = clustered ? colours.cluster : colours.sand;
      brush.beginPath();
      packing.radius.forEach((radius, grain) => {
        if (inCluster[grain] !== clustered) return;
        const [x, y] = at(grain);
        brush.moveTo(x + radius * scale, y);
        brush.arc(x, y, Math.max(radius * scale - 0.3, 0.3), 0, 7);
      });
      brush.fill();
    }
    const counts = [0, 0, 0];
    for (const kind of [1, 2]) {
      brush.strokeStyle = kind === 1 ? colours.p : colours.c;
      brush.lineWidth = clamp(scale * 500, 1, 4);
      brush.beginPath();
      kinds.forEach((one, row) => {
        if (one !== kind) return;
        counts[kind]++;
        const [[x, y], [toX, toY]] = [at(first[row]), at(packing.second[row])];
        brush.moveTo(0.72 * x + 0.28 * toX, 0.72 * y + 0.28 * toY);
        brush.lineTo(0.28 * x + 0.72 * toX, 0.28 * y + 0.72 * toY);
      });
      brush.stroke();
    }
    const points = path.map(at);
    for (const [colour, thickness] of [["wash", 5], ["way", 2.4]]) {
      brush.strokeStyle = colours[colour];
      brush.lineWidth = thickness;
      brush.lineJoin = "round";
      brush.beginPath();
      points.forEach(([x, y]) => brush.lineTo(x, y));
      brush.stroke();
    }
    let bare = 0;
    for (let place = 1; place < path.length; place++) {
      const [one, other] = [path[place - 1], path[place]];
      if (kindOf.get(Math.min(one, other) * packing.x.length + Math.max(one, other))) continue;
      bare++;
      brush.beginPath();
      brush.arc((points[place - 1][0] + points[place][0]) / 2, (points[place - 1][1] + points[place][1]) / 2, 4, 0, 7);
      brush.fillStyle = colours.wash;
      brush.fill();
      brush.strokeStyle = colours.bare;
      brush.lineWidth = 2;
      brush.stroke();
    }
    brush.strokeStyle = colours.quiet;
    brush.lineWidth = 1;
    brush.strokeRect(left, edge, packing.width * scale, packing.height * scale);
    packing.bands.forEach((half, side) => {
      brush.fillStyle = side ? colours.first_arrival : colours.peak;
      brush.fillRect(left + side * packing.width * scale - 2.5, edge + (packing.height / 2 - half) * scale, 5, 2 * half * scale);
    });
    brush.fillStyle = colours.ink;
    brush.textAlign = "center";
    for (const tick of ticks(0, packing.width / 1e3, width / 80)) brush.fillText(number(tick), left + tick * 1e3 * scale, height - bottom + 14);
    brush.fillText("x (mm)", left + (packing.width * scale) / 2, height - 8);
    brush.textAlign = "right";
    for (const tick of ticks(0, packing.height / 1e3, height / 80)) brush.fillText(number(tick), left - 5, edge + (packing.height - tick * 1e3) * scale + 4);
    brush.rotate(-Math.PI / 2);
    brush.textAlign = "center";
    brush.fillText("y (mm)", -height / 2, 11);
    const key = (colour, text) => `<span><span class="swatch" style="background:var(--${colour})"></span>${text}</span>`;
    const said = `${packing.x.length} grains, ${counts[1]} P contacts, ${counts[2]} C contacts` + (path.length ? `, preferential path of ${path.length - 1} contacts, ${bare} of them uncemented` : "");
    canvas.setAttribute("aria-label", `Sample of ${labelOf(opened)}: ${said}.`);
    byId("sample-keys").innerHTML =
      `<div class="keys">${key("sand", "sand grain")}${key("cluster", "grain in a cluster")}${key("p", `P contact (${counts[1]})`)}${key("c", `C contact (${counts[2]})`)}` +
      `${key("way", "preferential path")}${key("bare", `uncemented on it (${bare})`)}${key("peak", "transmitter")}${key("first_arrival", "receiver")}</div>` +
      `<p class="pages"><button type="button" data-zoom="0.5">smaller</button><button type="button" data-zoom="2">larger</button></p>`;
  }

  // Wiring -------------------------------------------------------------------------------------------------------

  function redraw() {
    if (!columns) return;
    drawMap();
    drawDetails();
  }
  function followLink(event) {
    const wanted = new URLSearchParams(location.hash.slice(1));
    const [seed, content] = [seeds.indexOf(Number(wanted.get("seed"))), contents.indexOf(Number(wanted.get("content")))];
    if (!wanted.has("seed") || seed < 0 || content < 0) return;
    openCell(seed * contents.length + content).then(() => {
      byId("cell").scrollIntoView({ block: "start" });
      if (event) byId("cell").focus({ preventScroll: true });
    });
  }
  function option(value, text) {
    return `<option value="${escape(value)}">${escape(text)}</option>`;
  }
  async function start() {
    ({ seeds, contents, columns, quantities } = await load("records"));
    cellCount = seeds.length * contents.length;
    const there = (name) => name in HEADINGS && ["seed", "content", "status", "vs"].concat(quantities.map((one) => one.name)).includes(name);
    shownColumns = [...SHOWN, ...SHOWN_LATER].filter(there);
    const numeric = quantities.filter(({ name, kind }) => kind !== "text" && name !== "vs");
    byId("colour").innerHTML =
      option("vs", "Vs") + option("deviation", "Vs against the mean of its content") + option("status", "outcome") +
      numeric.map(({ name, meaning }) => option(name, meaning)).join("");
    byId("content").innerHTML = option("", "all") + contents.map((content) => option(content, `${content} %`)).join("");
    const outcomes = [...new Set(Array.from({ length: cellCount }, (_, place) => statusOf(place)))].sort();
    byId("outcome").innerHTML = option("", "all") + outcomes.map((outcome) => option(outcome, number(outcome))).join("");
    const refreshColours = () => {
      shade();
      showScale();
      byId("map").setAttribute("aria-label", `Map of ${shades.label} over ${seeds.length} seeds (across) and ${contents.length} contents (upwards). Arrow keys move, Enter opens a cell.`);
      drawMap();
    };
    byId("filters").addEventListener("input", (event) => (event.target.id === "colour" ? refreshColours() : readFilters()));
    byId("filters").addEventListener("submit", (event) => event.preventDefault());
    byId("filters").addEventListener("reset", () => setTimeout(() => [refreshColours(), readFilters()]));
    byId("cells").addEventListener("click", (event) => {
      const name = event.target.dataset.sort;
      if (!name) return;
      order = { name, rising: order.name === name ? !order.rising : true };
      page = 0;
      sortRows();
    });
    byId("cell").addEventListener("click", (event) => {
      if (!event.target.dataset.zoom) return;
      zoom = clamp(zoom * Number(event.target.dataset.zoom), 1, 4);
      drawSample();
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
    refreshColours();
    readFilters();
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
  start();
})();
