// The explorer as a page of its own, with its data in elements of the page.

async function inflate(text) {
  const packed = Uint8Array.from(atob(text), (each) => each.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

const read = (id) => document.getElementById(id).textContent;
const page = document.getElementById("explorer");
const waiting = document.getElementById("waiting");
let data;
try {
  data = { header: JSON.parse(read("header")), bytes: await inflate(read("data")) };
} catch {
  waiting.textContent = "A part of this file is missing or damaged. Load it again, or make it again.";
}
if (data) {
  mount(page, data, { level: 1, linked: true });
  waiting.remove();
}
