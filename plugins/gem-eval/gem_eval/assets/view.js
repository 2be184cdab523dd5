"use strict";
(() => {
  const { make, draw, count } = transcripts;
  const $ = (id) => document.getElementById(id);
  const NUMBERS = ["return", "turns", "seconds", "tokens", "cost"];
  const LISTS = ["run", "outcome"];
  const TEXTS = ["model", "id", "reason", "text", "sort", "reverse", ...NUMBERS];
  const TYPING_MS = 200;
  const FOLLOW_MS = 500;

  // ---- What is shown; the address says it.

  const state = { run: [], outcome: [] };
  for (const name of [...TEXTS, "e", "beside", "turn"]) state[name] = "";

  function readAddress() {
    const asked = new URLSearchParams(location.hash.slice(1));
    for (const name of LISTS) state[name] = asked.getAll(name);
    for (const name of [...TEXTS, "e", "beside", "turn"]) state[name] = asked.get(name) || "";
  }

  function writeAddress() {
    const told = query();
    for (const name of ["e", "beside", "turn"]) if (state[name]) told.set(name, state[name]);
    const text = told.toString();
    if (text !== location.hash.slice(1)) history.replaceState(null, "", text ? `#${text}` : location.pathname);
  }

  function query() {
    const asked = new URLSearchParams();
    for (const name of LISTS) for (const value of state[name]) asked.append(name, value);
    for (const name of TEXTS) if (state[name]) asked.set(name, state[name]);
    return asked;
  }

  // ---- The server.

  async function get(path, parameters, options) {
    const answer = await fetch(`/api/${path}?${parameters}`, options);
    if (!answer.ok) throw new Error((await answer.text()) || answer.statusText);
    return answer;
  }

  const getJson = async (path, parameters) => (await get(path, parameters)).json();

  function episodeParameters(key, more) {
    const at = key.lastIndexOf("/");
    return new URLSearchParams({ run: key.slice(0, at), number: key.slice(at + 1), ...more });
  }

  const keyOf = (row) => `${row.run}/${row.number}`;

  // ---- Numbers as people read them.

  const number = (value) => (typeof value === "number" ? value.toLocaleString("en", { maximumFractionDigits: 3 }) : String(value ?? ""));
  const percent = (value) => `${(100 * value).toFixed(1)} %`;
  const money = (value) => (value === null ? "" : value >= 100 ? `$${value.toFixed(0)}` : `$${Number(value).toFixed(value >= 1 ? 2 : 4)}`);
  const seconds = (value) => (typeof value !== "number" ? "" : value < 100 ? `${value.toFixed(1)} s` : `${Math.round(value).toLocaleString("en")} s`);
  const shortModel = (name) => name.replace(/^openai:/, "");

  // ---- The list of runs.

  let runs = [];

  function drawRuns() {
    $("runs").replaceChildren(...runs.map(runCard));
    const chosen = runs.filter((run) => isChosen(run.name));
    const title = chosen.length === 1 ? chosen[0].name : `${chosen.length} runs`;
    document.title = `${title} · gem view`;
  }

  function isChosen(name) { return !state.run.length || state.run.includes(name); }

  function runCard(run) {
    const card = make("section", `run${isChosen(run.name) && state.run.length ? " chosen" : ""}`);
    const head = make("div", "run-head");
    const box = make("input");
    box.type = "checkbox";
    box.checked = isChosen(run.name);
    box.setAttribute("aria-label", `Show ${run.name}`);
    box.addEventListener("change", () => choose(run.name, box.checked));
    const name = make("button", "run-name", run.name);
    name.type = "button";
    name.title = `${run.path}: only this run`;
    name.addEventListener("click", () => { state.run = state.run.length === 1 && state.run[0] === run.name ? [] : [run.name]; changeQuery(); });
    head.append(box, name);
    if (runs.length === 1) box.hidden = true;
    const isRunning = run.live || run.status === "running";
    if (run.live) head.append(make("span", "live", "live"));
    card.append(head);
    const of = run.planned && run.planned !== run.episodes ? ` of ${number(run.planned)}` : "";
    const facts = [`${number(run.episodes ?? 0)}${of} episodes`];
    if (run.reading < 1) facts.push(`reading ${Math.floor(100 * run.reading)} %`);
    else if (run.status && !run.live) facts.push(run.status);
    if (run.damaged) facts.push(`${number(run.damaged)} damaged`);
    card.append(make("div", "figures", facts.join(" · ")));
    if (run.problem) card.append(make("div", "problem", run.problem));
    if (run.planned && isRunning) card.append(track("plan", 0, run.episodes / run.planned, null));
    card.append(...scoreLines(run));
    return card;
  }

  function scoreLines(run) {
    // One line for each model and task: by success where the task tells, else by return.
    const best = new Map();
    for (const score of run.scores) {
      const key = JSON.stringify([score.id, score.model]);
      if (!best.has(key) || score.metric === "success") best.set(key, score);
    }
    const scores = [...best.values()].sort((one, other) => (other.id === "all") - (one.id === "all") || (one.id < other.id ? -1 : one.id > other.id ? 1 : 0));
    const groups = [...new Set(scores.map((score) => score.id))];
    return groups.map((id, place) => {
      const element = make("details", "scores");
      element.append(make("summary", "", id === "all" ? "all tasks" : id));
      element.open = place === 0 || groups.length <= 3;
      element.append(...scores.filter((score) => score.id === id).map(scoreLine));
      return element;
    });
  }

  function scoreLine(score) {
    const line = make("button", "score");
    line.type = "button";
    const isRate = score.metric === "success";
    const show = (value) => (typeof value !== "number" ? "–" : isRate ? percent(value) : number(value));
    line.append(make("span", "score-model", shortModel(score.model)));
    line.append(make("span", "score-value", isRate ? show(score.mean) : `return ${show(score.mean)}`));
    if (isRate && typeof score.mean === "number") line.append(track("interval", score.low ?? score.mean, score.high ?? score.mean, score.mean));
    const interval = typeof score.low === "number" ? `, 95 % interval ${show(score.low)} to ${show(score.high)}` : "";
    const apart = [["errors", "errors"], ["truncated", "cut off"], ["unscored", "unscored"], ["unreadable", "unreadable"]]
      .filter(([name]) => score[name]).map(([name, label]) => `${number(score[name])} ${label}`);
    line.title = `${score.model} on ${score.id}: ${score.metric} ${show(score.mean)}${interval}; ${number(score.episodes)} episodes of ${number(score.rows)} rows${apart.length ? `; ${apart.join(", ")}` : ""}`;
    line.append(make("span", "score-apart", [typeof score.low === "number" ? `${show(score.low)} – ${show(score.high)}` : "", ...apart].filter(Boolean).join(" · ")));
    line.addEventListener("click", () => {
      const [id, model] = [score.id === "all" ? "" : score.id, score.model];
      const isSame = state.id === id && state.model === model;
      state.id = isSame ? "" : id;
      state.model = isSame ? "" : model;
      changeQuery();
    });
    return line;
  }

  function track(className, low, high, mark) {
    const element = make("span", `track ${className}`);
    const band = make("span", "band");
    band.style.left = `${100 * Math.max(0, low)}%`;
    band.style.width = `${100 * Math.max(0, Math.min(1, high) - Math.max(0, low))}%`;
    element.append(band);
    if (mark !== null) {
      const dot = make("span", "dot");
      dot.style.left = `${100 * mark}%`;
      element.append(dot);
    }
    return element;
  }

  function choose(name, wanted) {
    const all = runs.map((run) => run.name);
    const chosen = new Set(state.run.length ? state.run : all);
    if (wanted) chosen.add(name); else chosen.delete(name);
    state.run = chosen.size === all.length || !chosen.size ? [] : all.filter((each) => chosen.has(each));
    changeQuery();
  }

  // ---- Filters.

  let choices = null;

  function drawFilters() {
    const outcomes = choices ? choices.outcomes : [];
    $("outcomes").replaceChildren(...outcomes.filter(([name, found]) => found || state.outcome.includes(name)).map(([name, found]) => {
      const chip = make("button", `chip ${kind(name)}`);
      chip.type = "button";
      chip.setAttribute("aria-pressed", String(state.outcome.includes(name)));
      chip.append(make("span", "", name), make("b", "", number(found)));
      chip.addEventListener("click", () => {
        state.outcome = state.outcome.includes(name) ? state.outcome.filter((each) => each !== name) : [...state.outcome, name];
        changeQuery();
      });
      return chip;
    }));
    options($("model"), "all models", choices ? choices.models : [], state.model);
    options($("id"), "all tasks", choices ? choices.ids : [], state.id);
    options($("reason"), "all reasons", choices ? choices.reasons : [], state.reason);
    if (document.activeElement !== $("text")) $("text").value = found ? search.wanted : state.text;
    for (const name of NUMBERS) if (document.activeElement !== $(`n-${name}`)) $(`n-${name}`).value = state[name];
    const isFiltered = Boolean(state.outcome.length || state.model || state.id || state.reason || state.text || NUMBERS.some((name) => state[name]));
    $("clear").hidden = !isFiltered;
  }

  function kind(name) { return name.replace(" ", "-"); }

  function options(select, all, values, chosen) {
    const known = values.some(([value]) => value === chosen) || !chosen ? values : [[chosen, 0], ...values];
    select.hidden = known.length < 2 && !chosen;
    if (document.activeElement === select && select.dataset.chosen === chosen) return;
    select.dataset.chosen = chosen;
    select.replaceChildren(...[["", null], ...known].map(([value, found]) => {
      const option = make("option", "", value === "" ? all : `${value.length > 60 ? `${value.slice(0, 59)}…` : value}  (${number(found)})`);
      option.value = value;
      return option;
    }));
    select.value = chosen;
  }

  function makeFields() {
    for (const name of NUMBERS) {
      const field = make("input");
      Object.assign(field, { id: `n-${name}`, type: "text", placeholder: name, autocomplete: "off", spellcheck: false, title: `${name}: a comparison, as >0.5, or several: >0.2, <0.8` });
      field.setAttribute("aria-label", `Filter by ${name}`);
      field.addEventListener("input", later(() => {
        const isWhole = field.value.split(",").every((each) => !each.trim() || /^\s*(>=|<=|!=|==|>|<|=|)\s*[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?\s*$/i.test(each));
        field.classList.toggle("wrong", !isWhole);
        if (isWhole) { state[name] = field.value.trim(); changeQuery(); }
      }));
      $("numbers").append(field);
    }
    for (const name of ["model", "id", "reason"]) $(name).addEventListener("change", () => { state[name] = $(name).value; $(name).blur(); changeQuery(); });
    const filterByText = later(() => { state.text = $("text").value.trim(); changeQuery(); });
    $("text").addEventListener("input", filterByText);
    $("find").addEventListener("submit", (event) => {
      event.preventDefault();
      filterByText.cancel();
      search.start($("text").value.trim());
    });
    $("clear").addEventListener("click", () => {
      for (const name of ["model", "id", "reason", "text", ...NUMBERS]) state[name] = "";
      state.outcome = [];
      for (const name of NUMBERS) $(`n-${name}`).classList.remove("wrong");
      changeQuery();
    });
  }

  function later(action) {
    let timer = 0;
    const soon = () => { clearTimeout(timer); timer = setTimeout(action, TYPING_MS); };
    soon.cancel = () => clearTimeout(timer);
    return soon;
  }

  // ---- The table.

  // Name, title, least width, whether it may be left out where there is no room (the higher the sooner), how it is drawn.
  const COLUMNS = [
    ["number", "#", 56, 0, (row) => make("span", "num soft", number(row.number))],
    ["outcome", "Outcome", 96, 0, outcomeCell],
    ["run", "Run", 110, 3, (row) => make("span", "", row.run)],
    ["model", "Model", 120, 2, (row) => make("span", "", shortModel(row.model))],
    ["row", "Task", 150, 0, (row) => make("span", "", row.row)],
    ["epoch", "Epoch", 62, 6, (row) => make("span", "num", number(row.epoch))],
    ["return", "Return", 72, 1, (row) => make("span", "num", number(row.return))],
    ["turns", "Turns", 56, 4, (row) => make("span", "num", number(row.turns))],
    ["tokens", "Tokens", 76, 6, (row) => make("span", "num", number(row.tokens))],
    ["cost", "Cost", 78, 7, (row) => make("span", "num", money(row.cost))],
    ["seconds", "Time", 76, 5, (row) => make("span", "num", seconds(row.seconds))],
    ["reason", "Reason", 110, 8, (row) => make("span", "soft", row.error || row.reason)],
  ];
  const WIDE = ["row", "reason", "model", "run"];
  const LEFT = ["outcome", ...WIDE];
  let columns = COLUMNS;
  let selected = -1;
  let isLinked = false; // whether an episode was opened by its address, and its row is to be shown
  let found = null;

  function outcomeCell(row) {
    const cell = make("span", `outcome ${row.outcome}`, row.outcome);
    if (row.cutOff) cell.append(make("span", "cut", "✂"));
    return cell;
  }

  const remote = virtualTable.remoteRows(async (start, many) => {
    const asked = query();
    const meant = asked.toString();
    asked.set("start", start);
    asked.set("count", many);
    if (state.e) asked.set("at", state.e);
    try {
      const answer = await getJson("rows", asked);
      if (meant !== query().toString()) return answer;
      choices = answer.choices;
      if (!found) selected = answer.at ?? -1;
      if (isLinked && selected >= 0) {
        isLinked = false;
        setTimeout(() => table.reveal(selected));
      }
      summary = answer.summary;
      drawSummary();
      drawFilters();
      drawHead();
      return answer;
    } catch (error) {
      $("summary").textContent = error.message;
      throw error;
    }
  }, () => table.draw());

  const table = virtualTable.make({ scroller: $("scroller"), space: $("space"), body: $("rows"), drawRow });

  function drawRow(row, place) {
    const element = make("div", `row${place === selected ? " selected" : ""}${row ? "" : " waiting"}`);
    element.setAttribute("role", "row");
    element.setAttribute("aria-rowindex", String(place + 2));
    if (!row) return element;
    if (row.excerpt !== undefined) {
      element.append(make("span", "num soft", number(row.number)), outcomeCell(row), make("span", "soft", `${row.run} · ${row.row}`));
      element.append(transcripts.textInto(make("span", "excerpt"), row.excerpt.replace(/\s+/g, " "), search.wanted));
      element.classList.add("hit");
    } else {
      element.append(...columns.map((column) => column[4](row)));
    }
    [...element.children].forEach((cell) => { cell.setAttribute("role", "cell"); cell.title = cell.textContent; });
    element.addEventListener("click", () => open(place));
    return element;
  }

  function fittingColumns() {
    const has = choices ? choices.columns : [];
    const several = { run: runs.filter((run) => isChosen(run.name)).length > 1, model: choices ? choices.models.length > 1 : false };
    let fitting = COLUMNS.filter(([name]) => (name in several ? several[name] : ["epoch", "tokens", "cost", "seconds", "reason"].includes(name) ? has.includes(name) : true));
    const room = $("scroller").clientWidth - 24;
    while (fitting.reduce((sum, column) => sum + column[2] + 12, 0) > room && fitting.some((column) => column[3])) {
      const least = Math.max(...fitting.map((column) => column[3]));
      fitting = fitting.filter((column) => column[3] !== least);
    }
    return fitting;
  }

  function drawHead() {
    const fitting = fittingColumns();
    const sorts = `${state.sort} ${state.reverse} ${Boolean(found)}`;
    if (fitting.map(String).join() === columns.map(String).join() && $("head").dataset.sorts === sorts && $("head").childElementCount) return;
    columns = fitting;
    $("head").dataset.sorts = sorts;
    const width = ([name, , least]) => (WIDE.includes(name) ? `minmax(${least}px, ${name === "row" ? 4 : 1}fr)` : `${least}px`);
    $("table").style.setProperty("--columns", columns.map(width).join(" "));
    $("table").classList.toggle("hits", Boolean(found));
    $("head").replaceChildren(...(found ? [] : columns.map(headCell)));
    if (found) $("head").append(...["#", "Outcome", "Task", "Found"].map((title) => make("span", title === "#" ? "num" : "", title)));
    table.redraw();
  }

  function headCell([name, title]) {
    const button = make("button", LEFT.includes(name) ? "" : "num", title);
    button.type = "button";
    const isSorted = state.sort === name;
    button.setAttribute("role", "columnheader");
    button.setAttribute("aria-sort", isSorted ? (state.reverse ? "descending" : "ascending") : "none");
    if (isSorted) button.append(make("span", "arrow", state.reverse ? " ↓" : " ↑"));
    button.addEventListener("click", () => {
      // Ascending, descending, as written.
      if (!isSorted) [state.sort, state.reverse] = [name, ""];
      else if (!state.reverse) state.reverse = "1";
      else [state.sort, state.reverse] = ["", ""];
      changeQuery();
    });
    return button;
  }

  let summary = null;

  function drawSummary() {
    if (!summary) return;
    const pieces = [];
    const all = runs.filter((run) => isChosen(run.name)).reduce((sum, run) => sum + (run.episodes ?? 0), 0);
    const line = make("span");
    line.append(make("b", "", number(summary.episodes)), summary.episodes === all ? ` ${summary.episodes === 1 ? "episode" : "episodes"}` : ` of ${number(all)} episodes`);
    if (summary.success !== null) pieces.push(`success ${percent(summary.success)}`);
    if (summary.return !== null) pieces.push(`mean return ${number(summary.return)}`);
    if (summary.errors) pieces.push(`${number(summary.errors)} error${summary.errors === 1 ? "" : "s"}`);
    if (summary.cost !== null) pieces.push(money(summary.cost));
    line.append(pieces.map((piece) => ` · ${piece}`).join(""));
    if (!summary.episodes) line.append(all ? " fit. " : "");
    $("summary").replaceChildren(line);
  }

  function changeQuery() {
    search.stop();
    found = null;
    $("progress").hidden = true;
    selected = -1;
    writeAddress();
    drawRuns();
    drawFilters();
    drawHead();
    remote.reset();
    table.use(remote);
  }

  // ---- Search in transcripts: the server goes through the episodes of the table, and can be stopped.

  const search = {
    wanted: "",
    controller: null,
    stop() { if (this.controller) this.controller.abort(); this.controller = null; },
    async start(text) {
      this.stop();
      if (!text) return;
      const controller = new AbortController();
      Object.assign(this, { controller, wanted: text.toLowerCase() });
      // The text is looked for in transcripts, not in the rows.
      state.text = "";
      writeAddress();
      const asked = query();
      asked.set("wanted", text);
      found = [];
      selected = -1;
      drawHead();
      table.use(virtualTable.localRows(found));
      this.show({ done: 0, of: null, full: false }, true);
      try {
        const answer = await get("search", asked, { signal: controller.signal });
        const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
        let rest = "";
        for (;;) {
          const { value, done } = await reader.read();
          if (done) break;
          const lines = (rest + value).split("\n");
          rest = lines.pop();
          for (const line of lines) {
            const told = JSON.parse(line);
            found.push(...told.found);
            this.show(told, told.full === undefined);
          }
          table.draw();
        }
      } catch (error) {
        if (error.name !== "AbortError") this.show({ problem: error.message }, false);
      }
    },
    last: null,
    show(told, isRunning) {
      this.last = told;
      const bar = $("progress");
      const how = told.problem || `${isRunning ? "searching" : "searched"} ${number(told.done)}${told.of === null ? "" : ` of ${number(told.of)}`} episodes for “${this.wanted}” · ${number(found.length)} found${told.full ? ", and no more is looked for" : ""}`;
      const button = make("button", "", isRunning ? "Stop" : "Back to all");
      button.type = "button";
      button.addEventListener("click", () => {
        if (!isRunning) { changeQuery(); return; }
        this.stop();
        this.show(told, false);
      });
      const meter = track("plan", 0, told.of ? told.done / told.of : 0, null);
      bar.replaceChildren(make("span", "", how), meter, button);
      meter.hidden = !isRunning;
      bar.hidden = false;
    },
  };

  // ---- The reader: one episode, or two beside each other.

  const main = makePane("e");
  const other = makePane("beside");
  $("reader").append(main.element, other.element);

  function makePane(name) {
    const element = make("div", "pane");
    const bar = make("div", "pane-bar");
    const title = make("span", "pane-title");
    const find = make("input", "pane-find");
    Object.assign(find, { type: "search", placeholder: "Find in episode  ( s )", autocomplete: "off", spellcheck: false });
    find.setAttribute("aria-label", "Find in this episode");
    const places = make("span", "pane-count");
    const close = make("button", "close", "×");
    Object.assign(close, { type: "button", title: "Close ( Esc )" });
    close.setAttribute("aria-label", "Close");
    const siblings = make("div", "siblings");
    const article = make("article");
    article.tabIndex = -1;
    bar.append(title, find, places, close);
    element.append(bar, siblings, article);
    element.hidden = true;
    const pane = { element, article, find, data: null, drawn: null, siblings: null, show, hide, next: (by) => pane.drawn && pane.drawn.nextTurn(by) };
    let mark = -1;
    let wantedKey = "";

    function redraw(turn) {
      const key = keyOf(pane.data);
      const wanted = find.value.trim().toLowerCase() || (found ? search.wanted : "");
      pane.drawn = draw(article, pane.data, {
        wanted,
        imageSource: (image) => (/^[0-9a-f]{64}\.(png|tiff)$/.test(image) ? `/api/image?${new URLSearchParams({ run: pane.data.run, name: image })}` : null),
      });
      const head = article.querySelector(".head h2");
      head.after(make("div", "figures", [pane.data.run, pane.data.model, pane.data.row, seconds(pane.data.seconds), pane.data.cost === null ? "" : money(pane.data.cost)].filter(Boolean).join(" · ")));
      if (turn) pane.drawn.goToTurn(Number(turn) - 1);
      mark = -1;
      places.textContent = "";
      if (wanted) goToMark(0);
    }

    function goToMark(by) {
      if (!pane.drawn) return;
      pane.drawn.drawAll();
      const marks = [...article.querySelectorAll("mark")];
      mark = marks.length ? (mark < 0 ? 0 : (mark + by + marks.length) % marks.length) : -1;
      marks.forEach((each, place) => each.classList.toggle("here", place === mark));
      places.textContent = marks.length ? `${mark + 1} of ${marks.length}` : "not found";
      const here = marks[mark];
      if (!here) return;
      for (let outer = here.closest("details"); outer; outer = outer.parentElement.closest("details")) outer.open = true;
      here.scrollIntoView({ block: "center" });
    }

    async function show(key, turn) {
      wantedKey = key;
      state[name] = key;
      pane.data = pane.drawn = null;
      element.hidden = false;
      $("reader").hidden = false;
      document.body.classList.add("reading");
      title.textContent = key;
      writeAddress();
      try {
        const data = await getJson("episode", episodeParameters(key));
        if (wantedKey !== key) return;
        pane.data = data;
        redraw(turn);
        pane.siblings = drawSiblings(data);
      } catch (error) {
        if (wantedKey !== key) return;
        pane.data = pane.drawn = null;
        siblings.replaceChildren();
        article.replaceChildren(make("p", "empty", error.message));
      }
    }

    async function drawSiblings(data) {
      const answer = await getJson("rows", new URLSearchParams({ row: data.row, count: "40" }));
      if (pane.data !== data) return [];
      const rows = answer.rows;
      siblings.hidden = rows.length < 2;
      siblings.replaceChildren(make("span", "figures", "Same task:"), ...rows.map((row) => {
        const pair = make("span", `sibling${keyOf(row) === keyOf(data) ? " here" : ""}`);
        const several = runs.length > 1 ? `${row.run} · ` : "";
        const go = make("button", "", `${several}${shortModel(row.model)}${answer.choices.columns.includes("epoch") ? ` · ${row.epoch}` : ""}`);
        go.type = "button";
        go.prepend(make("span", `spot ${row.outcome}`));
        go.title = `${row.outcome}, return ${number(row.return)}`;
        go.addEventListener("click", () => show(keyOf(row)));
        pair.append(go);
        if (keyOf(row) !== keyOf(data) && name === "e") {
          const beside = make("button", "", "+");
          Object.assign(beside, { type: "button", title: "Beside this one ( b )" });
          beside.setAttribute("aria-label", `${keyOf(row)} beside this one`);
          beside.addEventListener("click", () => other.show(keyOf(row)));
          pair.append(beside);
        }
        return pair;
      }));
      return rows.map(keyOf).filter((key) => key !== keyOf(data));
    }

    function hide() {
      wantedKey = state[name] = "";
      pane.data = pane.drawn = null;
      element.hidden = true;
      article.replaceChildren();
    }

    close.addEventListener("click", () => (name === "e" ? closeReader() : (hide(), writeAddress())));
    find.addEventListener("input", later(() => pane.data && redraw()));
    find.addEventListener("keydown", (event) => {
      if (event.key === "Enter") { event.preventDefault(); goToMark(event.shiftKey ? -1 : 1); }
    });
    return pane;
  }

  function open(place) {
    const row = table.row(place);
    if (!row) return;
    selected = place;
    state.turn = "";
    if (!other.element.hidden) other.hide();
    main.show(keyOf(row));
    drawHead();
    table.redraw();
    table.reveal(place);
  }

  function closeReader() {
    main.hide();
    other.hide();
    state.turn = "";
    $("reader").hidden = true;
    document.body.classList.remove("reading");
    writeAddress();
    table.redraw();
    $("scroller").focus();
  }

  function nextEpisode(by) {
    const last = table.total() - 1;
    const place = selected < 0 ? 0 : Math.max(0, Math.min(last, selected + by));
    if (last < 0 || (place === selected && state.e)) return;
    if (table.row(place)) open(place);
    else table.reveal(place);
  }

  async function toggleBeside() {
    if (!other.element.hidden) { other.hide(); writeAddress(); return; }
    const [first] = main.data ? await main.siblings : [];
    if (first) other.show(first);
  }

  // ---- Keys.

  function onKey(event) {
    const typing = event.target.matches("input:not([type=checkbox]), select, textarea");
    if (event.key === "Escape") {
      if ($("help").open) return;
      if (typing) event.target.blur();
      else if (state.e) closeReader();
      else if (found) changeQuery();
      return;
    }
    if (typing || event.ctrlKey || event.metaKey || event.altKey || $("help").open) return;
    const actions = {
      j: () => nextEpisode(1), k: () => nextEpisode(-1), ArrowDown: () => nextEpisode(1), ArrowUp: () => nextEpisode(-1),
      n: () => goTurn(1), p: () => goTurn(-1), "/": () => { $("text").focus(); $("text").select(); },
      s: () => { if (main.data) { main.find.focus(); main.find.select(); } }, f: focusFilters, b: toggleBeside,
      c: copyLink, r: () => document.body.classList.toggle("no-runs"), "?": () => $("help").showModal(),
    };
    if (main.element.contains(document.activeElement) && event.key.startsWith("Arrow")) return;
    if (Object.hasOwn(actions, event.key)) { event.preventDefault(); actions[event.key](); }
  }

  function focusFilters() {
    document.body.classList.add("filtering");
    ($("outcomes").querySelector("button") || $("fields").querySelector("select, input")).focus();
  }

  function goTurn(by) {
    for (const pane of [main, other]) if (pane.drawn) pane.next(by);
    if (main.drawn) { state.turn = String(main.drawn.turn() + 1); writeAddress(); }
  }

  async function copyLink() {
    try {
      await navigator.clipboard.writeText(location.href);
      tell("link copied");
    } catch { tell("the link is in the address bar"); }
  }

  let told = 0;
  function tell(text) {
    $("link").textContent = text;
    clearTimeout(told);
    told = setTimeout(() => { $("link").textContent = ""; }, 2500);
  }

  // ---- Start, and follow runs that go on.

  let versions = "";

  function takeRuns(summaries) {
    runs = summaries;
    drawRuns();
    drawSummary();
    const now = runs.filter((run) => isChosen(run.name)).map((run) => `${run.name} ${run.version}`).join();
    if (now === versions) return;
    versions = now;
    if (found) return;
    remote.refresh();
    table.draw();
  }

  // Asks again and again what the runs are: also those that grow, and those that begin.
  async function follow() {
    for (let last = ""; ; await new Promise((resolve) => { setTimeout(resolve, FOLLOW_MS); })) {
      try {
        const text = await (await get("runs", "")).text();
        $("link").classList.remove("lost");
        if ($("link").textContent.startsWith("gem view has")) $("link").textContent = "";
        if (text !== last) takeRuns(JSON.parse(text));
        last = text;
      } catch {
        $("link").classList.add("lost");
        $("link").textContent = "gem view has ended; start it again";
      }
    }
  }

  function showAddressed() {
    isLinked = Boolean(state.e);
    changeQuery();
    if (state.e) main.show(state.e, state.turn); else if (!$("reader").hidden) closeReader();
    if (state.beside) other.show(state.beside);
  }

  makeFields();
  readAddress();
  $("show-runs").addEventListener("click", () => document.body.classList.toggle(matchMedia("(max-width: 900px)").matches ? "some-runs" : "no-runs"));
  $("show-help").addEventListener("click", () => $("help").showModal());
  document.addEventListener("keydown", onKey);
  addEventListener("hashchange", () => { readAddress(); showAddressed(); });
  new ResizeObserver(() => drawHead()).observe($("table"));
  showAddressed();
  follow();
})();
