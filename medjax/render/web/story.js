/** Fills in the policies' descriptions and the table of results. */
function fillStory(data, episodes) {
  data.words.forEach((words, which) => {
    if (!words) return;
    const name = element("dt", { textContent: episodes[which].meta.policy });
    if (episodes.length > 1) name.prepend(keyOf(which));
    $("policies").append(name, element("dd", { textContent: words }));
  });
  const wins = ({ better, digits, values }) => {
    const shown = values.map((value) => Number(value.toFixed(digits)));
    const best = Math[better < 0 ? "min" : "max"](...shown);
    return shown.map((value) => better !== 0 && new Set(shown).size > 1 && value === best);
  };
  const head = data.verdict.map(({ title }) => element("th", { textContent: title, scope: "col" }));
  const rows = episodes.map(({ meta }, which) => {
    const cells = data.verdict.map((row) => {
      const [text, best] = [row.values[which].toFixed(row.digits), wins(row)[which]];
      return element("td", { textContent: best ? `${text} \u2713` : text, className: best ? "better" : "" });
    });
    return [element("th", { textContent: meta.policy, scope: "row" }), ...cells];
  });
  data.means.forEach((texts, which) => {
    if (!texts) return;
    const title = `${episodes[which].meta.policy}, mean of ${data.evaluated} episodes`;
    const cells = texts.map((textContent) => element("td", { textContent, className: "mean" }));
    rows.push([element("th", { textContent: title, scope: "row", className: "mean" }), ...cells]);
  });
  fillTable($("verdict"), [[element("td"), ...head], ...rows], matchMedia("(max-width: 700px)").matches);
  const terms = data.verdict.filter(({ about }) => about).map(({ title, about }) => `${title}: ${about}`);
  if (data.means.some(Boolean)) terms.push("[ ]: 95 % interval of a mean");
  $("terms").textContent = terms.join("; ");
  $("ending").textContent = data.ending;
  $("outcome").open = window.matchMedia("(min-width: 1100px)").matches; // where it fits beside the words
}

/** Fills a table with rows of cells; `turned` swaps rows and columns for narrow screens. */
function fillTable(table, cells, turned) {
  if (turned) {
    const other = { row: "col", col: "row" };
    for (const cell of cells.flat()) if (cell.scope) cell.scope = other[cell.scope];
  }
  const shown = turned ? cells[0].map((_, column) => cells.map((row) => row[column])) : cells;
  const [first, ...rest] = shown.map((row) => element("tr", {}, row));
  table.append(element("thead", {}, [first]), element("tbody", {}, rest));
}

const HASH_MS = 300;

/** `#t=123&follow=MED3`: time and followed vehicle in the page's address, as a link to share. */
class Address {
  constructor(player) {
    this.player = player;
    this.waits = null;
    window.addEventListener("hashchange", () => this.read());
  }

  /** Goes to the time and vehicle of the address. */
  read() {
    const { player } = this;
    const given = new URLSearchParams(window.location.hash.slice(1));
    const wanted = given.get("follow")?.toLowerCase();
    const track = wanted && player.episodes[0].tracks.find(({ name }) => name.replace(" ", "").toLowerCase() === wanted);
    if (track) {
      player.select(0, track);
      player.setCamera("selected");
    }
    const seconds = Number.parseFloat(given.get("t"));
    if (Number.isFinite(seconds)) player.seek(seconds);
  }

  /** Writes the address after a moment without changes, since browsers refuse frequent updates. */
  keep(seconds) {
    clearTimeout(this.waits);
    if (window.location.protocol === "about:") return; // in a frame of another page
    const { selected, camera } = this.player;
    const follow = selected?.which === 0 && camera.mode === "selected" ? `&follow=${selected.track.name.replace(" ", "")}` : "";
    const hash = `#t=${Number(seconds.toFixed(2))}${follow}`;
    if (hash === window.location.hash) return;
    this.waits = setTimeout(() => window.history.replaceState(null, "", hash), HASH_MS);
  }
}
