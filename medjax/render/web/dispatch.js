/** Decisions of one policy: the probabilities at the clock's time, and all dispatched MEDs. */
class DispatchPanel {
  constructor(episode, which, player) {
    Object.assign(this, { episode, player, decision: -1 });
    const { meta, tables } = episode;
    this.title = element("h2", { textContent: player.episodes.length > 1 ? `Dispatch: ${meta.policy}` : "Dispatch" });
    this.now = element("p");
    this.rows = Array.from({ length: tables.probability.rows }, (_, action) => this._row(action));
    const body = element("tbody", {}, this.rows.map(({ row }) => row));
    const table = element("table", { className: `actions ${LINE_COLORS[which]}` }, [body]);
    table.setAttribute("aria-label", "Probability of each action");
    this.reward = element("p");
    this.sent = this._sent();
    const list = element("ul", { className: "sent-list" }, this.sent.map(({ item }) => item));
    const heading = element("h3", { textContent: `MEDs sent: ${this.sent.length}, fleet ${meta.fleet}` });
    this.plot = new Plot({
      lines: [{
        values: (i) => 1 - tables.probability.at(0, i),
        count: episode.decisions,
        step: episode.decisionSeconds,
        color: LINE_COLORS[which],
      }],
      end: episode.seconds,
      theme: player.theme,
      label: "Probability of sending a MED over time",
      onSeek: (seconds) => player.seek(seconds),
    });
    const chance = element("h3", { textContent: "Probability of sending a MED" });
    this.root = element("div", {}, [
      this.title, this.now, table, this.reward, chance, this.plot.root, heading, list,
    ]);
  }

  resize() {
    this.plot.resize();
  }

  update(seconds) {
    const { episode } = this;
    this.plot.moveTo(seconds);
    const decision = Math.min(Math.floor(seconds / episode.decisionSeconds + 1e-6), episode.decisions - 1);
    if (decision === this.decision) return;
    this.decision = decision;
    const { action, sent, mask, probability, cooldown, reward, terms } = episode.tables;
    const chosen = action.at(0, decision);
    const went = sent.at(0, decision);
    const time = clockText(decision * episode.decisionSeconds);
    const waiting = decision > 0 ? cooldown.at(0, decision - 1) : 0;
    const wait = waiting > 0 ? `; the next one may be sent in ${waiting.toFixed(0)} s` : "";
    this.now.textContent = `Decision at ${time}: ${went > 0 ? `a MED from ramp ${went}` : "none sent"}${wait}`;
    this.rows.forEach(({ row, bar, number }, index) => {
      const share = probability.at(index, decision);
      const allowed = mask.at(index, decision) === 1;
      row.className = `${allowed ? "" : "masked"} ${index === chosen ? "chosen" : ""}`;
      bar.style.transform = `scaleX(${share})`;
      number.textContent = allowed ? share.toFixed(3) : "not allowed";
    });
    const parts = episode.meta.rewardTerms
      .map((name, i) => [name, terms.at(i, decision)])
      .filter(([, value]) => Math.abs(value) >= 5e-4)
      .map(([name, value]) => `${name.replaceAll("_", " ")} ${value.toFixed(3)}`);
    const sum = reward.at(0, decision).toFixed(3);
    this.reward.textContent = `Reward ${sum}${parts.length ? ` = ${parts.join(", ")}` : ""}`;
    for (const { item } of this.sent) item.firstChild.removeAttribute("aria-current");
    const latest = this.sent.findLast((one) => one.seconds <= seconds + 1e-6);
    latest?.item.firstChild.setAttribute("aria-current", "true");
  }

  _row(action) {
    const bar = element("div");
    const number = element("td");
    const row = element("tr", {}, [
      element("td", { textContent: this.episode.meta.actions[action] }),
      element("td", { className: "bar" }, [bar]),
      number,
    ]);
    return { row, bar, number };
  }

  _sent() {
    const { sent, probability } = this.episode.tables;
    const found = [];
    for (let decision = 0; decision < sent.times; decision += 1) {
      const ramp = sent.at(0, decision);
      if (ramp < 1) continue;
      const seconds = decision * this.episode.decisionSeconds;
      const share = probability.at(ramp, decision).toFixed(2);
      const item = listButton(`${clockText(seconds)} ramp ${ramp} (p ${share})`, () => this.player.seek(seconds));
      found.push({ seconds, item });
    }
    return found;
  }
}
