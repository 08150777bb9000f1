// A closer look at one cell: signals, sample with cement and path, and record.
let details = null; // what is drawn of the opened cell, to draw it again in other colours or sizes
let zoom = 1;
let showsForces = false; // where the packing has them

async function openCell(place) {
  opened = cursor = place;
  const { cells, sections, problem } = await source.cell(place);
  const cell = cells.find((one) => one.content === contentOf(place));
  const section = sections.find((one) => one.content === contentOf(place));
  const found = { signal: cell?.signal, section, packing: null, problem };
  if (cell?.cement) {
    const packing = await source.packing(cell.packing);
    const kinds = new Uint8Array(packing.second.length);
    for (const one of cells) {
      if (one.packing !== cell.packing || !one.cement) continue;
      one.cement.forEach((rows, kind) => sums(rows).forEach((row) => (kinds[row] = kind)));
      if (one === cell) break;
    }
    Object.assign(found, { packing, kinds, path: sums(cell.path ?? []) });
  }
  if (opened !== place) return;
  details = found;
  showCell(place);
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
  const absent = (what) => `<p class="quiet">${details.problem ? escape(details.problem) : source.holds(place) ? `No ${what} is stored.` : "Not in this page; see above."}</p>`;
  const rows = quantities
    .map(({ name, unit, meaning }) => [meaning, meaning.startsWith("relative") ? percent(valueOf(name, place), 4) : withUnit(valueOf(name, place), unit, 6)])
    .filter(([, text]) => text !== MISSING);
  byId("cell").innerHTML = `
    <h3>S${labelOf(place).slice(1)}: ${vs === null ? escape(number(statusOf(place))) : `Vs = ${number(vs)} m/s`}</h3>
    ${worthOf(place)}${reason ? `<p>${escape(reason)}</p>` : ""}
    <nav aria-label="Neighbours"><ul>${around.map(([at]) => `<li><a href="${link(at)}">${labelOf(at)}</a></li>`).join("")}
      <li><a href="#explore">map</a></li></ul></nav>
    <div class="columns">
      <div class="signals"><h4>Signals</h4>${details.signal ? `<div id="signal"></div>` : absent("signal")}
        ${details.section ? `<h4>Section</h4><div id="section"></div>` : ""}<div id="more"></div></div>
      <div class="sample"><h4>Sample</h4>${details.packing ? `<div id="sample-keys"></div><div id="sample" tabindex="0" role="region" aria-label="Sample"><canvas role="img"></canvas></div>` : absent("cement pattern")}</div>
      <div class="record"><h4>Record</h4><table id="record"><tbody>
        ${rows.map(([meaning, text]) => `<tr><th scope="row">${escape(meaning)}</th><td>${escape(text)}</td></tr>`).join("")}
      </tbody></table></div>
    </div>`;
  byId("cell").hidden = false;
  source.extend(place, byId("more"));
  drawDetails();
  drawMap();
}
/** What the velocity of a cell is worth, in sentences. */
function worthOf(place) {
  const [vs, error] = [columns.vs[place], columns.vs_error?.[place]];
  if (vs === null || error === null || error === undefined) return "";
  const ends = [-1, 1].map((side) => number(vs * (1 + side * normal95 * error)));
  const parts = ["reading_error", "numerical_error", "pulse_effect"].map((name) => percent(columns[name]?.[place]));
  const made = !parts.includes(MISSING) ? ` (reading ${parts[0]}, simulation ${parts[1]}, pulse ${parts[2]})` : "";
  const other = isLoud(place) ? " ~ It depends on the pulse, so it is no property of the sample." : "";
  const effective = columns.effective_vs?.[place];
  const sample = effective ? ` Effective velocity ${withUnit(effective, "m/s")}, standard error ${percent(columns.effective_error[place])}.` : "";
  return `<p>95 % interval ${ends[0]} to ${ends[1]} m/s; standard error ${percent(error)}${made}.${other}${sample}</p>`;
}
function drawDetails() {
  if (details?.signal && byId("signal")) drawSignal(details.signal);
  if (details?.section && byId("section")) drawSection(details.section);
  if (details?.packing && byId("sample")) drawSample();
}

function drawSignal({ start, interval, transmitted, received, unit, arrivals }) {
  const host = byId("signal");
  const [width, height, left, bottom, top] = [host.clientWidth, 280, 62, 44, 10];
  const series = { transmitted: sums(transmitted.steps), received: sums(received.steps) };
  const scaleOf = (values) => Math.max(...values.map(Math.abs)) || 1;
  for (const name of ["transmitted", "received"]) {
    const scale = scaleOf(series[name]);
    series[name] = series[name].map((value) => value / scale);
  }
  const count = series.transmitted.length;
  const end = start + interval * (count - 1);
  const least = Math.min(-0.2, ...series.transmitted, ...series.received) - 0.05;
  const x = (time) => left + (time / end) * (width - left - 10);
  const y = (value) => top + ((1.08 - value) / (1.08 - least)) * (height - top - bottom);
  const curve = (name) => {
    const points = series[name].map((value, at) => `${x(start + interval * at).toFixed(1)},${y(value).toFixed(1)}`);
    return `<polyline points="${points.join(" ")}" fill="none" stroke="var(--${name})" stroke-width="${name === "transmitted" ? 1.5 : 2}"${name === "transmitted" ? ` stroke-dasharray="5 3"` : ""}/>`;
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
  const said = found.map((method) => `${method.replace("_", " ")}: ${withUnit(columns[`vs_${method}`]?.[opened] ?? null, "m/s")}, ${number(arrivals[method])} ms`);
  const label = `Transmitted and received signal of ${labelOf(opened)} over ${number(end)} ms. ${said.join("; ") || "No arrival was read"}.`;
  host.innerHTML = `
    <svg viewBox="0 0 ${width} ${height}" tabindex="0" role="img" aria-label="${escape(label)}">
      ${across.join("")}${upward.join("")}${curve("transmitted")}${curve("received")}${marks.join("")}
      <line id="hair" y1="${top}" y2="${height - bottom}" stroke="var(--ink)" visibility="hidden"/>
      <text x="${(left + width) / 2}" y="${height - 8}" text-anchor="middle">time (ms)</text>
      <text transform="translate(14 ${(height - bottom) / 2}) rotate(-90)" text-anchor="middle">signal / its largest value</text>
    </svg>
    <div class="keys">${key("transmitted", `transmitted (largest ${number(transmitted.largest)} m/s)`)}${key("received", `received (largest ${number(received.largest)} ${unit})`)}${found.map((method, at) => key(method, said[at])).join("")}</div>
    <p class="quiet" id="reading" role="status">Values under the pointer, or with the arrow keys.</p>`;
  const svg = host.firstElementChild;
  let at = 0;
  const read = (place) => {
    at = clamp(place, 0, count - 1);
    const hair = svg.querySelector("#hair");
    for (const name of ["x1", "x2"]) hair.setAttribute(name, x(start + interval * at));
    hair.setAttribute("visibility", "visible");
    const [one, other] = [series.transmitted[at] * transmitted.largest, series.received[at] * received.largest].map((value) => Number(value.toPrecision(3)));
    byId("reading").textContent = `${number(start + interval * at)} ms: transmitted ${number(one)} m/s, received ${number(other)} ${unit}`;
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

/** Motion at each station, with the lines to the peak that is read and to that of the fitted wave. */
function drawSection({ start, interval, levels, places, traces, begin, coherence, peaks }) {
  const host = byId("section");
  const [width, height, left, bottom, top] = [host.clientWidth, 340, 62, 44, 22];
  const end = start + interval * (traces[0].length - 1);
  const distance = places.at(-1);
  const reach = (1.15 * distance) / places.length; // of the largest value of a trace
  const x = (time) => left + (time / end) * (width - left - 10);
  const y = (place) => top + ((distance + reach - place) / (distance + 2 * reach)) * (height - top - bottom);
  const across = ticks(0, end, width / 90).map((time) => `<line x1="${x(time)}" x2="${x(time)}" y1="${top}" y2="${height - bottom}" stroke="var(--line)"/><text x="${x(time)}" y="${height - bottom + 16}" text-anchor="middle">${number(time)}</text>`);
  const upward = ticks(0, distance, 5).map((place) => `<text x="${left - 6}" y="${y(place) + 4}" text-anchor="end">${number(place)}</text>`);
  const wiggles = traces.map((steps, station) => {
    const points = sums(steps).map((value, at) => `${x(start + interval * at).toFixed(1)},${y(places[station] + (reach * value) / levels).toFixed(1)}`);
    return `<polyline points="${points.join(" ")}" fill="none" stroke="var(--${station === traces.length - 1 ? "ink" : "received"})" stroke-width="1.4"/>`;
  });
  const shown = peaks.filter(([travel]) => begin + travel <= end);
  // Numbers stand above the ends of their lines, as far as they do not overlap, nor leave the drawing.
  const textAt = new Map();
  let room = width - 14;
  for (const [travel] of [...shown].sort(([one], [other]) => other - one)) {
    textAt.set(travel, Math.min(x(begin + travel), room));
    room = textAt.get(travel) - 48;
  }
  const lines = shown.map(([travel, isChosen]) => {
    const colour = isChosen ? "peak" : "quiet";
    return `<line x1="${x(begin)}" y1="${y(0)}" x2="${x(begin + travel)}" y2="${y(distance)}" stroke="var(--${colour})" stroke-width="${isChosen ? 2 : 1.2}"${isChosen ? "" : ` stroke-dasharray="5 4"`}/><text x="${textAt.get(travel)}" y="${top - 6}" text-anchor="middle"${isChosen ? ` font-weight="bold"` : ""}>${number(travel, 3)}</text>`;
  });
  const chosen = shown.find(([, isChosen]) => isChosen);
  const said = chosen ? `The S wave is the peak at ${number(chosen[0])} ms of travel` : "No peak is the S wave";
  host.innerHTML = `
    <svg viewBox="0 0 ${width} ${height}" role="img" aria-label="Section of ${escape(labelOf(opened))}: ${places.length - 1} stations and the receiver. ${said}.">
      ${across.join("")}${upward.join("")}${wiggles.join("")}${lines.join("")}
      <text x="${(left + width) / 2}" y="${height - 8}" text-anchor="middle">time (ms)</text>
      <text transform="translate(14 ${(height - bottom) / 2}) rotate(-90)" text-anchor="middle">path (mm), receiver last</text>
    </svg>
    <div class="keys">${key("received", "station")}${key("ink", "receiver")}${chosen ? key("peak", "line of the peak that is read") : ""}${shown.length > (chosen ? 1 : 0) ? key("quiet", "peak of the fitted wave") : ""}</div>
    <p class="quiet">Each trace over its largest value. Numbers above: travel time, ms. The fitted wave has a coherence of ${coherence === null ? "-" : coherence.toFixed(2)}. ${said}.</p>`;
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
  const contactOf = (one, other) => Math.min(one, other) * packing.x.length + Math.max(one, other);
  const kindOf = new Map();
  kinds.forEach((kind, row) => {
    kindOf.set(contactOf(first[row], packing.second[row]), kind);
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
  const hasForces = showsForces && packing.forces;
  if (hasForces) {
    brush.strokeStyle = colours.ink;
    brush.lineCap = "round";
    packing.forces.forEach((percent, row) => {
      if (percent < 50) return;
      brush.lineWidth = clamp((percent / 100) * scale * 130, 0.4, 9);
      brush.beginPath();
      brush.moveTo(...at(first[row]));
      brush.lineTo(...at(packing.second[row]));
      brush.stroke();
    });
    brush.lineCap = "butt";
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
    if (kindOf.get(contactOf(path[place - 1], path[place]))) continue;
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
  const said = `${packing.x.length} grains, ${counts[1]} P contacts, ${counts[2]} C contacts` + (path.length ? `, preferential path of ${path.length - 1} contacts, ${bare} of them uncemented` : "");
  canvas.setAttribute("aria-label", `Sample of ${labelOf(opened)}: ${said}.`);
  byId("sample-keys").innerHTML =
    `<div class="keys">${key("sand", "sand grain")}${key("cluster", "grain in a cluster")}${key("p", `P contact (${counts[1]})`)}${key("c", `C contact (${counts[2]})`)}` +
    `${key("way", "preferential path")}${key("bare", `uncemented on it (${bare})`)}${key("peak", "transmitter")}${key("first_arrival", "receiver")}</div>` +
    (packing.forces ? `<p class="quiet"><label><input type="checkbox" id="forces"${showsForces ? " checked" : ""}> forces of the packing: lines as wide as the force of a contact, those of half the mean and more</label></p>` : "") +
    `<p class="pages"><button type="button" data-zoom="0.5">smaller</button><button type="button" data-zoom="2">larger</button></p>`;
}
