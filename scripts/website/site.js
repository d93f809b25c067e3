"use strict";
// Search, copy buttons, and contents that are closed on phones. Without it every page reads as it is.
let entries = null; // [page, heading, address, text] of search.js, which is read when the search is first used
const up = document.documentElement.dataset.up, field = document.getElementById("search"), found = document.getElementById("found");
const details = document.querySelector("nav details");
if (matchMedia("(max-width: 760px)").matches) details.open = false;
document.querySelector("nav .here")?.scrollIntoView({ block: "nearest" });
if (matchMedia("(hover: hover)").matches) field.placeholder = "Search  /";

function score(entry, words) {
  const [page, head, , text] = entry.map(each => each.toLowerCase());
  let sum = 0;
  for (const word of words) {
    const at = head.indexOf(word), below = text.split(word).length - 1;
    if (at < 0 && !below && !page.includes(word)) return 0;
    const begins = at === 0 || /\W/.test(head[at - 1]), ends = at + word.length === head.length || /\W/.test(head[at + word.length]);
    if (at >= 0) sum += (head === word ? 50 : 0) + (begins ? 20 : 0) + (begins && ends ? 25 : 0) + 20 + 10 * word.length / head.length;
    sum += (page.includes(word) ? 8 : 0) + Math.min(below, 5);
  }
  return sum;
}

function marked(text, words) {
  const part = document.createElement("span"), any = new RegExp(`(${words.map(w => w.replace(/[^\w\s]/g, "\\$&")).join("|")})`, "gi");
  text.split(any).forEach((piece, at) => {
    const mark = document.createElement(at % 2 ? "mark" : "span");
    mark.textContent = piece;
    part.append(mark);
  });
  return part;
}

function show() {
  if (!entries) return load();
  const words = field.value.toLowerCase().split(/\s+/).filter(Boolean);
  found.hidden = !words.length;
  found.replaceChildren();
  if (found.hidden) return;
  const best = entries.map(entry => [score(entry, words), entry]).filter(([s]) => s > 0).sort((a, b) => b[0] - a[0]).slice(0, 12);
  for (const [, [page, head, address, text]] of best) {
    const [link, line, from, below] = ["a", "div", "small", "p"].map(name => document.createElement(name));
    const at = Math.max(0, text.toLowerCase().indexOf(words[0]) - 50);
    link.href = up + address;
    from.textContent = page;
    below.append(marked((at ? "… " : "") + text.slice(at, at + 150), words));
    line.append(marked(head, words), from);
    link.append(line, below);
    found.append(link);
  }
  if (!best.length) found.textContent = "Nothing found.";
}

function load() {
  if (document.getElementById("index")) return;
  const script = document.createElement("script");
  script.id = "index";
  script.src = `${up}search.js`;
  script.onload = show;
  document.head.append(script);
}

field.addEventListener("focus", load);
field.addEventListener("input", show);
document.addEventListener("keydown", event => {
  const links = [...found.querySelectorAll("a")], at = links.indexOf(document.activeElement);
  if (event.key === "/" && document.activeElement !== field) field.focus();
  else if (event.key === "Escape") { field.value = ""; show(); field.blur(); }
  else if (event.key === "Enter" && document.activeElement === field && links.length) links[0].click();
  else if (event.key === "ArrowDown" && !found.hidden) links[Math.min(at + 1, links.length - 1)]?.focus();
  else if (event.key === "ArrowUp" && at >= 0) (links[at - 1] || field).focus();
  else return;
  event.preventDefault();
});
found.addEventListener("click", event => { if (event.target.closest("a")) { field.value = ""; show(); details.open &&= innerWidth > 760; } });

for (const block of document.querySelectorAll(".code:not(.signature)")) {
  const button = document.createElement("button");
  button.textContent = "copy";
  button.onclick = async () => {
    await navigator.clipboard.writeText(block.querySelector("pre").textContent);
    button.textContent = "copied";
    setTimeout(() => { button.textContent = "copy"; }, 1500);
  };
  block.append(button);
}
