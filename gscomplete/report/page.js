"use strict";
const page = JSON.parse(document.getElementById("data").textContent);
const several = new Set(page.cards.map((card) => card.method)).size > 1;
let splatView = null;

function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value); else element.setAttribute(name, value);
  }
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}
const shown = (value, measure) => value === null || value === undefined ? "-" : value.toFixed(measure.digits);
const headOf = (m) => `${m.label} ${m.lower ? "\u2193" : "\u2191"}`;

function meansTable() {
  const head = make("tr", {}, make("th", { class: "text" }, "objects"), make("th", { class: "text" }, "method"), make("th", {}, "n"),
    ...page.measures.map((m) => make("th", {}, headOf(m))));
  const begins = (index) => index === 0 || page.means[index - 1].group !== page.means[index].group;
  const rows = page.means.map((mean, index) => make("tr", begins(index) ? { class: "begin" } : {},
    make("td", { class: "text" }, begins(index) ? mean.group : ""), make("td", { class: "text" }, mean.method),
    make("td", {}, String(mean.count)), ...page.measures.map((m) => {
      const cell = mean.cells[m.name];
      if (!cell) return make("td", {}, "-");
      return make("td", cell.best ? { class: "best" } : {}, shown(cell.value, m),
        make("span", { class: "interval" }, mean.count > 1 ? `${shown(cell.low, m)} to ${shown(cell.high, m)}` : ""));
    })));
  return make("div", { class: "scroll" }, make("table", {}, make("thead", {}, head), make("tbody", {}, ...rows)));
}

function objectsTable() {
  const columns = [["object", (c) => c.object], ["subset", (c) => c.subset || "-"], ["method", (c) => c.method],
    ["seconds", (c) => c.seconds, { digits: 1 }], ...page.measures.map((m) => [headOf(m), (c) => c.values[m.name], m])];
  const body = make("tbody");
  let cards = page.cards.map((card, index) => [card, index]);
  const fill = () => body.replaceChildren(...cards.map(([card, index]) => make("tr", {}, ...columns.map(([, get, m], k) => {
    const text = m ? shown(get(card), m) : get(card);
    return make("td", m ? {} : { class: "text" }, k === 0 ? make("a", { href: `#card-${index}` }, text) : text);
  }))));
  const head = make("tr", {}, ...columns.map(([label, get, m]) => {
    const cell = make("th", m ? { "aria-sort": "none" } : { class: "text", "aria-sort": "none" });
    cell.append(make("button", { onclick: () => {
      const rising = cell.getAttribute("aria-sort") !== "ascending";
      for (const other of cell.parentNode.children) other.setAttribute("aria-sort", "none");
      cell.setAttribute("aria-sort", rising ? "ascending" : "descending");
      const value = ([card]) => get(card), missing = (v) => v === null || v === undefined;
      cards = [...cards].sort((a, b) => {
        const [x, y] = [value(a), value(b)];
        if (missing(x) || missing(y)) return missing(x) - missing(y);
        return (x < y ? -1 : x > y ? 1 : 0) * (rising ? 1 : -1);
      });
      fill();
    } }, label));
    return cell;
  }));
  fill();
  return make("div", { class: "scroll long" }, make("table", { id: "objects" }, make("thead", {}, head), body));
}

function openViewer(card, shot, tools) {
  try {
    splatView = splatView || new SplatView();
  } catch (error) {
    tools.append(make("span", { class: "warn" }, String(error.message)));
    return;
  }
  for (const button of document.querySelectorAll(".tools .extra")) button.remove();
  const full = card.holds_input ? "all" : "new";
  splatView.spin = false; splatView.show = full; splatView.tint = 0;
  shot.append(splatView.canvas);
  splatView.load([page.inputs[card.input], card.added], page.packing, card.azimuth_deg, card.elevation_deg);
  const extra = (label, act, pressed) => {
    const button = make("button", { class: "extra", "aria-pressed": String(pressed), onclick: () => { act(button); splatView.draw(); } }, label);
    tools.append(button);
    return button;
  };
  const shows = (card.holds_input ? [["completion", "all"], ["input", "input"], ["added", "new"]] : [["completion", "new"], ["input", "input"]])
    .map(([label, show]) => extra(label, (pressed) => {
      splatView.show = show;
      for (const other of shows) other.setAttribute("aria-pressed", String(other === pressed));
    }, show === full));
  const toggle = (label, flip) => extra(label, (button) => button.setAttribute("aria-pressed", String(Boolean(flip()))), false);
  toggle("tints", () => { splatView.tint = 1 - splatView.tint; return splatView.tint; });
  toggle("turntable", () => { splatView.spin = !splatView.spin; return splatView.spin; });
  extra("pictures", () => { splatView.spin = false; splatView.canvas.remove(); for (const b of tools.querySelectorAll(".extra")) b.remove(); }, false);
}

function pairs(title, values) {
  const entries = Object.entries(values || {});
  if (!entries.length) return null;
  return make("details", {}, make("summary", {}, title),
    make("dl", {}, ...entries.flatMap(([name, value]) => [make("dt", {}, name), make("dd", {}, String(value))])));
}

function cardElement(card, index) {
  const shot = make("div", { class: "shot" }, make("img", { src: card.picture, loading: "lazy", decoding: "async",
    alt: `input above completion of ${card.object}, from c, c+60 and c+180 degrees` }),
    make("span", { class: "label", style: "top:.3rem" }, "input"), make("span", { class: "label", style: "top:51.5%" }, "completion; inset: error on P"));
  const tools = make("div", { class: "tools" });
  tools.append(make("button", { class: "open", onclick: () => openViewer(card, shot, tools) }, "3D"));
  const numbers = Object.fromEntries(page.measures.filter((m) => card.values[m.name] !== null && card.values[m.name] !== undefined)
    .map((m) => [m.label, shown(card.values[m.name], m)]));
  const made = {};
  if (card.settings) made.settings = card.settings;
  for (const [name, source] of Object.entries(card.sources || {})) made[`${name} from`] = source;
  const keys = [card.subset, card.method, card.seconds === null ? null : `${card.seconds.toFixed(1)} s`].filter(Boolean).join(" \u00b7 ");
  const head = several ? [make("h4", {}, card.method), make("p", { class: "soft" }, summary(card))]
    : [make("h3", {}, card.object), make("p", { class: "soft" }, `\u201c${card.prompt}\u201d \u00b7 ${keys}`)];
  return make("article", { class: "card", id: `card-${index}` }, ...head, shot, tools,
    pairs("numbers", numbers), pairs("options", made), pairs("timings (s)", card.timings),
    card.notes.length ? make("details", {}, make("summary", { class: "warn" }, `notes and warnings (${card.notes.length})`),
      make("ul", {}, ...card.notes.map((note) => make("li", {}, note)))) : null,
    pairs("unavailable", card.unavailable));
}

function summary(card) { // the numbers that tell methods of an object apart
  const told = page.measures.filter((m) => ["e_color_v", "silhouette_iou", "hidden_psnr_db"].includes(m.name))
    .map((m) => `${m.label} ${shown(card.values[m.name], m)}`);
  if (card.seconds !== null) told.push(`${card.seconds.toFixed(1)} s`);
  return told.join(" \u00b7 ");
}

function cardElements() {
  const elements = page.cards.map(cardElement);
  if (!several) return [make("div", { class: "cards" }, ...elements)];
  const groups = new Map();
  page.cards.forEach((card, index) => groups.set(card.object, [...(groups.get(card.object) || []), index]));
  return [...groups].map(([object, members]) => {
    const { prompt, subset } = page.cards[members[0]];
    return make("section", { class: "object" }, make("h3", {}, object),
      make("p", { class: "soft" }, `\u201c${prompt}\u201d${subset ? ` \u00b7 ${subset}` : ""}`),
      make("div", { class: "cards" }, ...members.map((index) => elements[index])));
  });
}

document.body.append(make("h1", {}, page.title),
  make("p", { class: "soft" }, `${page.cards.length} completions \u00b7 gscomplete ${page.version} \u00b7 depths and distances in object sizes; means with 95 % bootstrap intervals over objects`),
  ...page.unavailable.map(([label, why]) => make("p", { class: "soft" }, `${label}: unavailable: ${why}`)),
  make("h2", {}, "Means"), meansTable(), make("h2", {}, "Objects"), objectsTable(),
  make("h2", {}, "Completions"), ...cardElements());
