// The live page: how campaigns stand and what their cells are, as the server tells it.
const campaigns = new Map(); // by number: what was told last, cells, and the elements that show them
const SERIES = ["received", "peak", "first_arrival", "cross_correlation", "bare", "c"];
let current = null; // number of the campaign whose cells are shown
let begun = false;
let isChosenByUser = false;

const colourOf = (campaign) => SERIES[campaign % SERIES.length];
const element = (tag, properties = {}, ...children) => {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
};
const plural = (count, word) => `${count.toLocaleString("en")} ${word}${count === 1 ? "" : "s"}`;
function duration(seconds) {
  if (seconds === null || seconds === undefined) return MISSING;
  if (seconds < 90) return `${Math.round(seconds)} s`;
  if (seconds < 5400) return `${Math.round(seconds / 60)} min`;
  return seconds < 172800 ? `${number(seconds / 3600, 2)} h` : `${number(seconds / 86400, 2)} days`;
}
async function ask(address, options) {
  const answer = await fetch(address, options);
  if (!answer.ok) throw new Error(`${address}: ${answer.status}`);
  return answer;
}

// Cells --------------------------------------------------------------------------------------------------------

const addressOf = (place) => `cell?seed=${seedOf(place)}&content=${contentOf(place)}`;
const packings = new Map();
const source = {
  holds: () => true,
  async cell(place) {
    try {
      return await (await ask(`campaigns/${current}/${addressOf(place)}`)).json();
    } catch {
      return { cells: [], sections: [], problem: "The server does not answer." };
    }
  },
  async packing(index) {
    const address = `campaigns/${current}/packings/${index}`;
    if (!packings.has(address)) packings.set(address, await (await ask(address)).json());
    return packings.get(address);
  },
  extend(place, host) {
    if (!columns.status[place]) return;
    const quoted = (text) => `'${text.replaceAll("'", "'\\''")}'`; // for a shell
    const { database, name } = campaigns.get(current).status;
    const cell = `--campaign ${quoted(name)} --seed ${seedOf(place)} --content ${contentOf(place)}`;
    const command = `calcidem show ${quoted(database)} ${cell} --movie wave.gif`;
    host.append(element("h4", { textContent: "Movie of the wave" }), element("code", { textContent: command }));
  },
};

/** Take apart what `CellColumns.packed` has put together. */
function unpack(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const records = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const count = records.seeds.length * records.contents.length;
  const types = { Uint32: Uint32Array, Float32: Float32Array, Float64: Float64Array };
  const columns = {};
  for (const { name, type, offset, texts } of records.columns) {
    const values = new types[type](buffer, 4 + length + offset, count);
    columns[name] = Array.from(values, type === "Uint32" ? (at) => texts[at] : (value) => (Number.isNaN(value) ? null : value));
  }
  return Object.assign(records, { columns });
}
async function fetchRecords(campaign) {
  if (campaign.fetching) return;
  campaign.fetching = true;
  try {
    const buffer = await (await ask(`campaigns/${campaign.number}/records`)).arrayBuffer();
    if (buffer.byteLength) campaign.records = unpack(buffer);
  } catch {
    // The stream of events says what is wrong, and asks again.
  }
  campaign.fetching = false;
  if (!campaign.records) return;
  drawMiniatures();
  if (current === campaign.number || current === null || (!isChosenByUser && campaign.number < current)) choose(campaign.number);
  if (campaign.records.sequence < campaign.status.sequence) setTimeout(() => fetchRecords(campaign), 500);
}
function takeCells({ campaign: number, sequence, places, columns: changed }) {
  const campaign = campaigns.get(number);
  const records = campaign?.records;
  if (!records || sequence <= records.sequence) return;
  if (sequence > records.sequence + 1) return void fetchRecords(campaign);
  records.sequence = sequence;
  for (const [name, values] of Object.entries(changed)) {
    if (records.columns[name]) values.forEach((value, at) => (records.columns[name][places[at]] = value));
  }
  later("miniatures", drawMiniatures);
  if (number !== current) return;
  later("cells", refresh);
  if (places.includes(opened)) openCell(opened);
}
/** Do something soon, once for all that ask for it meanwhile; of many cells it takes a while. */
const waiting = new Set();
function later(name, action) {
  if (waiting.has(name)) return;
  waiting.add(name);
  setTimeout(() => [waiting.delete(name), action()], cellCount > 20000 ? 2000 : 200);
}
function choose(number) {
  const campaign = campaigns.get(number);
  if (!campaign.records?.seeds.length) return;
  const same = current === number;
  current = number;
  if (!same) {
    opened = null;
    details = null;
    byId("cell").hidden = true;
    page = 0;
    history.replaceState(null, "", location.pathname + location.search); // the same cell of this campaign is another one
  }
  byId("cells-of").hidden = false;
  markChosen();
  if (begun) take(campaign.records);
  else start(campaign.records);
  begun = true;
}

/** Say whose cells are shown, where there are several campaigns. */
function markChosen() {
  const shown = campaigns.get(current);
  put(byId("which"), shown && campaigns.size > 1 ? `These are the cells of ${shown.status.name}, in ${shown.status.database}.` : "");
  for (const { button, number } of campaigns.values()) button?.setAttribute("aria-pressed", String(number === current));
}

// Campaigns ----------------------------------------------------------------------------------------------------

function takeStatus(status) {
  if (!campaigns.has(status.campaign)) addCampaign(status.campaign);
  const campaign = campaigns.get(status.campaign);
  campaign.status = status;
  showStatus(campaign);
  markChosen();
  later("growth", showGrowth);
  if (status.sequence > (campaign.records?.sequence ?? 0)) fetchRecords(campaign);
}
function addCampaign(number) {
  const parts = {};
  for (const [name, tag] of [["name", "h2"], ["database", "p"], ["state", "p"], ["progress", "progress"], ["share", "p"], ["notes", "p"], ["facts", "dl"], ["reasons", "details"]]) {
    parts[name] = element(tag);
  }
  parts.database.className = parts.share.className = "quiet";
  parts.facts.className = "facts";
  parts.progress.setAttribute("aria-label", "Cells finished");
  const card = element("article", { className: "campaign" }, ...Object.values(parts));
  const campaign = { number, parts, card, records: null, status: null, fetching: false };
  campaigns.set(number, campaign);
  byId("loading")?.remove();
  byId("campaigns").append(card);
  if (campaigns.size === 2) campaigns.forEach(addMiniature);
  else if (campaigns.size > 2) addMiniature(campaign);
}
function addMiniature(campaign) {
  campaign.canvas = element("canvas");
  campaign.canvas.setAttribute("role", "img");
  campaign.canvas.addEventListener("click", (event) => {
    const box = campaign.canvas.getBoundingClientRect();
    const { seeds, contents } = campaign.records ?? {};
    if (!seeds) return;
    isChosenByUser = true;
    choose(campaign.number);
    const seed = seeds[clamp(Math.floor(((event.clientX - box.left) / box.width) * seeds.length), 0, seeds.length - 1)];
    const content = contents[clamp(Math.floor((1 - (event.clientY - box.top) / box.height) * contents.length), 0, contents.length - 1)];
    location.hash = `#seed=${seed}&content=${content}`;
  });
  campaign.button = element("button", { type: "button", textContent: "Show its cells" });
  campaign.button.addEventListener("click", () => [(isChosenByUser = true), choose(campaign.number), byId("cells-of").scrollIntoView()]);
  campaign.card.append(campaign.canvas, campaign.button);
}
/** The maps of all campaigns, small, in the same colours: seeds to the right, contents upwards. */
function drawMiniatures() {
  const drawn = [...campaigns.values()].filter(({ canvas, records }) => canvas && records?.seeds.length);
  let [low, high] = [Infinity, -Infinity];
  for (const { records } of drawn) for (const vs of records.columns.vs) if (vs !== null) [low, high] = [Math.min(low, vs), Math.max(high, vs)];
  const failed = paint("absent");
  byId("shared").hidden = !drawn.length;
  put(byId("shared"), `Maps above: seeds to the right, contents upwards, colours from ${number(low, 3)} (dark) to ${number(high, 3)} m/s (bright) in all campaigns; grey: no velocity.`);
  for (const { canvas, records, status } of drawn) {
    const [width, height] = [records.seeds.length, records.contents.length];
    [canvas.width, canvas.height] = [width, height];
    const brush = canvas.getContext("2d");
    records.columns.vs.forEach((vs, place) => {
      if (vs === null && !records.columns.status[place]) return;
      brush.fillStyle = vs === null ? failed : mix(RISING, (vs - low) / (high - low || 1));
      brush.fillRect(Math.floor(place / height), height - 1 - (place % height), 1, 1);
    });
    const known = records.columns.vs.filter((vs) => vs !== null).length;
    canvas.setAttribute("aria-label", `Map of ${status.name}: ${known} of ${width * height} cells have a velocity, from ${number(low, 3)} to ${number(high, 3)} m/s in all campaigns.`);
  }
}
function stateOf({ problem, checked, running, run, cells, workers }) {
  if (problem) return problem;
  if (checked < 1) return `Stored numbers are being compared with their checksums: ${Math.floor(100 * checked)} %.`;
  if (!cells) return "";
  if (running && run) return `Running on ${run.host} with ${plural(workers, "worker")} since ${run.started}.`;
  if (!cells.pending) return "Finished: every cell has an outcome.";
  if (!run) return "Not begun.";
  return `Not running. Run ${run.number}, of ${run.started}: ${run.exit_state || "stopped unexpectedly"}. The same command continues.`;
}
function showStatus({ parts, status }) {
  const { cells = {}, contents = [], reasons = [], notes = [] } = status;
  const planned = Object.values(cells).reduce((sum, count) => sum + count, 0);
  const [pending, done] = [cells.pending ?? 0, cells.done ?? 0];
  const finished = planned - pending;
  put(parts.name, status.name);
  put(parts.database, status.database);
  put(parts.state, stateOf(status));
  parts.progress.max = Math.max(planned, 1);
  parts.progress.value = finished;
  put(parts.share, `${finished.toLocaleString("en")} of ${plural(planned, "cell")} finished (${planned ? Math.floor((100 * finished) / planned) : 0} %)`);
  const facts = [
    ["cells with a velocity", done.toLocaleString("en")],
    ["cells without velocity", (finished - done).toLocaleString("en")],
    ["waiting", pending.toLocaleString("en")],
    ["time left", pending ? duration(status.seconds_left) : "none"],
    [status.running ? "workers" : "workers, last run", status.run ? String(status.workers) : MISSING],
    ["standard error of Vs", percent(status.vs_error)],
  ];
  put(parts.facts, facts.map(([term, value]) => `<div><dt>${term}</dt><dd>${escape(value)}</dd></div>`).join(""), true);
  put(parts.notes, notes.join(" "));
  parts.reasons.hidden = !reasons.length;
  if (!reasons.length) return;
  const rows = reasons.map((one) => `<tr><td>${escape(one.outcome.replace("_", " "))}</td><td class="long">${escape(one.reason)}</td><td>${one.contents.join(", ")}</td><td>${one.cells}</td></tr>`);
  if (!parts.reasons.firstChild) {
    parts.reasons.innerHTML = `<summary></summary><div class="ends"><div class="scroll" tabindex="0" role="region" aria-label="Cells without velocity"><table><thead><tr><th scope="col">outcome</th><th scope="col">reason</th><th scope="col">contents (%)</th><th scope="col">cells</th></tr></thead><tbody></tbody></table></div></div>`;
    watchEnds(parts.reasons.querySelector(".scroll"));
  }
  put(parts.reasons.firstChild, `${plural(reasons.reduce((sum, one) => sum + one.cells, 0), "cell")} without velocity, and why`);
  put(parts.reasons.querySelector("tbody"), rows.join(""), true);
}
/** Change an element only where it has to: what is selected, focused or being read aloud stays. */
function put(host, text, isMarkup = false) {
  if (host.shown === text) return;
  host.shown = text;
  if (isMarkup) host.innerHTML = text;
  else host.textContent = text;
}

// Mean and scatter ---------------------------------------------------------------------------------------------

/** Cells with a velocity, of those that are planned. */
function counted({ cells }) {
  return `${cells.done ?? 0} of ${Object.values(cells).reduce((sum, count) => sum + count, 0)}`;
}
/** Name of a campaign, with its database if another one has the same name. */
function nameOf({ name, database }) {
  return [...campaigns.values()].filter(({ status }) => status.name === name).length > 1 ? `${name}, ${database}` : name;
}
function showGrowth() {
  const shown = [...campaigns.values()].filter(({ status }) => status.contents?.length);
  byId("growth").hidden = !shown.length;
  if (!shown.length) return;
  const several = campaigns.size > 1;
  const known = shown.flatMap(({ number: campaign, status }) => status.contents.filter(({ mean }) => mean !== null).map((one) => ({ ...one, campaign, name: nameOf(status) })));
  drawGrowth(shown, known);
  const names = [...(several ? ["campaign"] : []), "content (%)", "cells with a velocity", "mean Vs (m/s)", "95 % of the mean (m/s)", "standard deviation (m/s)", "time for a cell", "time left"];
  put(byId("numbers").tHead, `<tr>${names.map((name) => `<th scope="col">${name}</th>`).join("")}</tr>`, true);
  const rows = shown.flatMap(({ status }) => status.contents.map((one) => {
    const values = [
      ...(several ? [nameOf(status)] : []),
      number(one.content), counted(one), number(one.mean), one.interval_95[0] === null ? MISSING : one.interval_95.map((end) => number(end)).join(" to "),
      number(one.sd, 3), one.seconds_per_cell === null ? MISSING : `${number(one.seconds_per_cell, 2)} s`,
      one.cells.pending ? duration(one.core_seconds_left === null ? null : one.core_seconds_left / status.workers) : "none",
    ];
    return `<tr>${values.map((value) => `<td class="short">${escape(value)}</td>`).join("")}</tr>`;
  }));
  put(byId("numbers").tBodies[0], rows.join(""), true);
}
function drawGrowth(shown, known) {
  const [width, height, left, bottom, top] = [Math.max(byId("chart").clientWidth, 280), 250, 62, 44, 12];
  // Of two or three samples the interval is so wide that it would leave nothing else to see: it is cut at the edge.
  const reach = (one) => [-1, 1].map((side) => one.mean + side * Math.max(one.sd ?? 0, Math.min(2 * (one.sd ?? 0), (one.interval_95[1] ?? one.mean) - one.mean)));
  const values = known.flatMap(reach);
  const [least, most] = values.length ? [Math.min(...values), Math.max(...values)] : [0, 1];
  const margin = 0.05 * (most - least || most || 1);
  const [low, high] = [Math.max(0, least - margin), most + margin];
  const contents = shown.flatMap(({ status }) => status.contents.map(({ content }) => content));
  const [first, last] = [Math.min(...contents), Math.max(...contents)];
  const x = (content) => left + 14 + ((content - first) / (last - first || 1)) * (width - left - 38);
  const y = (vs) => top + ((high - clamp(vs, low, high)) / (high - low)) * (height - top - bottom);
  const upward = values.length ? ticks(low, high, 6).map((vs) => `<line x1="${left}" x2="${width - 10}" y1="${y(vs)}" y2="${y(vs)}" stroke="var(--line)"/><text x="${left - 6}" y="${y(vs) + 4}" text-anchor="end">${number(vs)}</text>`) : [];
  const across = ticks(first, last, width / 80).map((content) => `<text x="${x(content)}" y="${height - bottom + 18}" text-anchor="middle">${number(Number(content.toPrecision(6)))}</text>`);
  const marks = known.map((one) => {
    const [bottomEnd, topEnd] = one.interval_95;
    const [at, colour] = [x(one.content) + 7 * (one.campaign - (campaigns.size - 1) / 2), `var(--${colourOf(one.campaign)})`];
    const bar = one.sd === null ? "" : `<line x1="${at}" x2="${at}" y1="${y(one.mean - one.sd)}" y2="${y(one.mean + one.sd)}" stroke="${colour}" stroke-width="9" stroke-opacity=".28"/>`;
    const whisker = bottomEnd === null ? "" : `<path d="M${at} ${y(bottomEnd)}V${y(topEnd)}M${at - 4} ${y(bottomEnd)}h8M${at - 4} ${y(topEnd)}h8" stroke="${colour}" stroke-width="1.8" fill="none"/>`;
    return `${bar}${whisker}<circle cx="${at}" cy="${y(one.mean)}" r="3.6" fill="${colour}"><title>${escape(`${one.name}, ${one.content} %: ${number(one.mean)} m/s, ${counted(one)} cells`)}</title></circle>`;
  });
  const said = `Mean Vs against calcite content: ${known.length} of ${contents.length} contents have a mean${values.length ? `, from ${number(Math.min(...known.map(({ mean }) => mean)))} to ${number(Math.max(...known.map(({ mean }) => mean)))} m/s` : ""}. The numbers are in the table below.`;
  put(byId("chart"), `<svg viewBox="0 0 ${width} ${height}" role="img" aria-label="${escape(said)}">
      ${upward.join("")}${across.join("")}<line x1="${left}" x2="${width - 10}" y1="${height - bottom}" y2="${height - bottom}" stroke="var(--quiet)"/>${marks.join("")}
      ${values.length ? "" : `<text x="${(left + width) / 2}" y="${height / 2 - bottom / 2}" text-anchor="middle">No cell has a velocity yet.</text>`}
      <text x="${(left + width) / 2}" y="${height - 6}" text-anchor="middle">calcite content (%)</text>
      <text transform="translate(14 ${(height - bottom) / 2}) rotate(-90)" text-anchor="middle">Vs (m/s)</text>
    </svg>`, true);
  put(byId("chart-keys"), campaigns.size > 1 ? shown.map(({ number: campaign, status }) => key(colourOf(campaign), escape(nameOf(status)))).join("") : "", true);
}

// What the server tells ----------------------------------------------------------------------------------------

const stream = new EventSource("events");
const connection = (text, isLost) => {
  put(byId("connection"), text);
  byId("connection").classList.toggle("lost", isLost);
};
stream.addEventListener("open", () => connection("Live: stored cells appear here within seconds.", false));
stream.addEventListener("error", () => {
  const isComplete = campaigns.size > 0 && [...campaigns.values()].every(({ status }) => status.cells && !status.cells.pending);
  connection(isComplete ? "The server has ended. All cells are below; 'calcidem serve DB' shows them again." : "The connection is lost: the server has ended, or can't be reached. Below is what was stored before.", !isComplete);
});
stream.addEventListener("status", (event) => takeStatus(JSON.parse(event.data)));
stream.addEventListener("cells", (event) => takeCells(JSON.parse(event.data)));
addEventListener("resize", () => later("growth", showGrowth));
for (const place of [prefersDark, byId("theme")]) place.addEventListener(place === prefersDark ? "change" : "click", drawMiniatures);
