// Data of the report: in <script> elements of this page as JSON, compressed, in base64; see cell_data.py.
const cache = new Map();
function load(id) {
  if (!cache.has(id)) cache.set(id, decompress(byId(id).textContent).json());
  return cache.get(id);
}
function decompress(text) {
  const bytes = Uint8Array.from(atob(text), (sign) => sign.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate")));
}
for (const image of document.querySelectorAll("img[data-packed]")) {
  const vectors = decompress(byId(image.dataset.packed).textContent).arrayBuffer();
  vectors.then((bytes) => (image.src = URL.createObjectURL(new Blob([bytes], { type: "image/svg+xml" }))));
}
const source = {
  holds: (place) => byId(`seed-${seedOf(place)}`) !== null,
  async cell(place) {
    const ids = [`seed-${seedOf(place)}`, `sections-${seedOf(place)}`];
    const [cells, sections] = await Promise.all(ids.map((id) => (byId(id) ? load(id) : [])));
    return { cells, sections };
  },
  packing: (index) => load(`packing-${index}`),
  extend() {},
};
load("records").then(start);
