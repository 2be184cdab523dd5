"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const $ = (id) => document.getElementById(id);
  const episodes = data.episodes;
  let shown = [];
  let current = null;
  let turnAt = -1;

  // All text of others goes through textContent: nothing of it is ever read as HTML.
  function make(tag, className, text) {
    const element = document.createElement(tag);
    if (className) element.className = className;
    if (text !== undefined) element.textContent = text;
    return element;
  }

  function query() { return $("search").value.trim().toLowerCase(); }

  function haystack(episode) {
    if (episode.haystack === undefined) {
      const pieces = [];
      const gather = (value) => {
        if (typeof value === "string") pieces.push(value.toLowerCase());
        else if (value && typeof value === "object") Object.values(value).forEach(gather);
      };
      gather([episode.id, episode.returns, episode.error, episode.start, episode.observation, episode.turns, episode.final]);
      episode.haystack = pieces.join("\n");
    }
    return episode.haystack;
  }

  function textInto(element, text) {
    const wanted = query();
    const lower = text.toLowerCase();
    // Where lower case is longer than the text, places would not fit.
    if (!wanted || lower.length !== text.length) { element.textContent = text; return element; }
    let from = 0;
    for (let marks = 0; marks < 1000; marks += 1) {
      const at = lower.indexOf(wanted, from);
      if (at < 0) break;
      element.append(text.slice(from, at), make("mark", "", text.slice(at, at + wanted.length)));
      from = at + wanted.length;
    }
    element.append(text.slice(from));
    return element;
  }

  function bars(turns, large) {
    const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
    const count = Math.max(turns.length, 1);
    const step = large ? Math.max(4, Math.min(28, Math.floor(860 / count))) : Math.max(1, Math.min(6, 96 / count));
    const height = large ? 44 : 14;
    const most = Math.max(...turns.map((turn) => turn.reward), 0);
    const least = Math.min(...turns.map((turn) => turn.reward), 0);
    const span = most - least || 1;
    const zero = most === least ? height - 2 : (height - 2) * (most / span) + 1;
    svg.setAttribute("class", large ? "bars large" : "bars");
    svg.setAttribute("viewBox", `0 0 ${step * count} ${height}`);
    svg.setAttribute("width", String(step * count));
    svg.setAttribute("height", String(height));
    svg.setAttribute("role", "img");
    svg.setAttribute("aria-label", `Rewards: ${turns.slice(0, 100).map((turn) => turn.rewardText).join(", ")}`);
    const rect = (x, y, width, tall, className) => {
      const element = document.createElementNS("http://www.w3.org/2000/svg", "rect");
      const sizes = { x, y, width, height: tall };
      for (const name of Object.keys(sizes)) element.setAttribute(name, String(sizes[name]));
      element.setAttribute("class", className);
      svg.append(element);
      return element;
    };
    turns.forEach((turn, place) => {
      const tall = turn.reward === 0 ? 2 : Math.max((Math.abs(turn.reward) / span) * (height - 2), 2);
      const top = turn.reward > 0 ? zero - tall : turn.reward < 0 ? zero : Math.min(zero, height - 2);
      const kind = turn.reward > 0 ? "plus" : turn.reward < 0 ? "minus" : "zero";
      rect(place * step, top, Math.max(step - (step > 3 ? 2 : 0), 0.8), tall, kind);
    });
    if (large) {
      turns.forEach((turn, place) => {
        const hit = rect(place * step, 0, step, height, "hit");
        const title = document.createElementNS("http://www.w3.org/2000/svg", "title");
        title.textContent = `turn ${turn.number}: reward ${turn.rewardText}`;
        hit.append(title);
        hit.addEventListener("click", () => goToTurn(place));
      });
    }
    return svg;
  }

  function partsInto(block, parts) {
    const repeated = parts.filter((part) => part.repeated);
    if (repeated.length) {
      const details = make("details");
      const length = repeated.reduce((sum, part) => sum + part.text.length, 0);
      details.append(make("summary", "", `${length.toLocaleString("en")} characters as in the turn before`));
      repeated.forEach((part) => details.append(partElement(part, "dim")));
      details.open = Boolean(query()) && repeated.some((part) => part.text.toLowerCase().includes(query()));
      block.append(details);
    }
    parts.filter((part) => !part.repeated).forEach((part) => block.append(partElement(part, "")));
    return block;
  }

  function partElement(part, className) {
    const source = part.kind === "image" && Object.hasOwn(data.images, part.text) ? data.images[part.text] : null;
    if (source === null) {
      const text = part.kind === "image" ? `[image ${part.text}]` : part.text;
      return textInto(make("pre", part.kind === "role" ? "role" : part.kind === "text" ? className : "dim"), text);
    }
    const image = make("img");
    image.addEventListener("load", () => { if (image.naturalWidth < 128) image.className = "small"; });
    image.src = source;
    image.alt = `image ${part.text.slice(0, 12)}`;
    return image;
  }

  function block(label, className, aside) {
    const element = make("div", `block ${className}`);
    const head = make("div", "label", label);
    if (aside) head.append(textInto(make("span"), aside));
    element.append(head);
    return element;
  }

  function textBlock(label, text, className, aside) {
    const element = block(label, className || "", aside);
    element.append(text ? textInto(make("pre"), text) : make("pre", "dim", "(empty)"));
    return element;
  }

  function figures(episode) {
    const count = episode.count;
    return `${episode.returns || `return ${episode.return}`} · ${count} turn${count === 1 ? "" : "s"}`;
  }

  function turnCard(turn, count) {
    const card = make("section", "turn");
    const head = make("header");
    head.append(make("h3", "", `Turn ${turn.number} of ${count}${turn.seat ? ` · ${turn.seat}` : ""}`));
    turn.flags.forEach((flag) => head.append(make("span", "flag", flag)));
    const sign = turn.reward > 0 ? " success" : turn.reward < 0 ? " failure" : "";
    head.append(make("span", `reward${sign}`, `reward ${turn.rewardText}`));
    card.append(head, partsInto(block("Observation", ""), turn.observation));
    if (turn.reasoning) card.append(textBlock("Reasoning", turn.reasoning, "said"));
    card.append(textBlock("Response", turn.response, "said", turn.reported));
    turn.calls.forEach((call) => card.append(textBlock("Tool call", call, "said")));
    if (turn.feedback.length) card.append(partsInto(block("Feedback", ""), turn.feedback));
    if (turn.error) card.append(textBlock("Error", turn.error, "error"));
    const names = Object.keys(turn.rest);
    if (names.length) {
      const element = block("Info", "");
      const list = make("dl", "facts");
      names.forEach((name) => list.append(make("dt", "", name), textInto(make("dd"), turn.rest[name])));
      element.append(list);
      card.append(element);
    }
    return card;
  }

  function open(episode, moveFocus) {
    current = episode;
    turnAt = -1;
    const article = $("episode");
    article.replaceChildren();
    for (const button of $("list").querySelectorAll("button")) {
      const here = Number(button.dataset.number) === (episode && episode.number);
      button.setAttribute("aria-current", String(here));
      if (here) button.scrollIntoView({ block: "nearest" });
    }
    if (!episode) {
      article.append(make("p", "empty", episodes.length ? "No episode fits." : "There are no episodes."));
      return;
    }
    const head = make("div");
    head.append(make("h2", "", `${episode.number} · ${episode.id}`));
    const line = make("div");
    line.append(make("span", `outcome ${episode.outcome}`, episode.outcome));
    line.append(make("span", "figures", ` · ${figures(episode)}`));
    head.append(line);
    if (episode.turns.some((turn) => turn.reward !== 0)) head.append(bars(episode.turns, true));
    const facts = make("dl", "facts");
    Object.keys(episode.start).forEach((name) => {
      facts.append(make("dt", "", name), textInto(make("dd"), episode.start[name]));
    });
    head.append(facts);
    article.append(head);
    const add = (label, parts) => {
      const card = make("section", "turn");
      card.append(partsInto(block(label, ""), parts));
      if (label !== "Observation" && episode.error) card.append(textBlock("Error", episode.error, "error"));
      article.append(card);
    };
    if (episode.observation.length) add("Observation", episode.observation);
    episode.turns.forEach((turn) => article.append(turnCard(turn, episode.count)));
    add("Final observation", episode.final);
    article.scrollTop = 0;
    if (moveFocus) {
      document.body.classList.add("reading");
      document.querySelector("main").scrollTop = 0;
      history.replaceState(null, "", `#${episode.number}`);
    }
  }

  function goToTurn(place) {
    const cards = [...$("episode").querySelectorAll(".turn")];
    if (!cards.length) return;
    turnAt = Math.max(0, Math.min(cards.length - 1, place));
    cards.forEach((card, at) => card.classList.toggle("here", at === turnAt));
    cards[turnAt].scrollIntoView({ block: "start" });
  }

  function goToEpisode(by) {
    const place = shown.indexOf(current);
    const next = shown[Math.max(0, Math.min(shown.length - 1, place + by))];
    if (next && next !== current) open(next, true);
  }

  function filter() {
    const wanted = query();
    const env = $("env").value;
    const outcome = $("outcome").value;
    shown = episodes.filter((episode) => (!env || episode.id === env) && (!outcome || episode.outcome === outcome)
      && (!wanted || haystack(episode).includes(wanted)));
    const order = $("sort").value;
    if (order === "return") shown.sort((one, other) => Number(other.return) - Number(one.return) || one.number - other.number);
    if (order === "turns") shown.sort((one, other) => other.count - one.count || one.number - other.number);
    const solved = shown.filter((episode) => episode.outcome === "success").length;
    const judged = solved + shown.filter((episode) => episode.outcome === "failure").length;
    const rate = judged ? ` · ${((100 * solved) / judged).toFixed(0)} % success` : "";
    $("count").textContent = `${shown.length} of ${episodes.length} episodes${rate}`;
    $("list").replaceChildren(...shown.map(listItem));
    open(shown.includes(current) ? current : shown[0] || null, false);
  }

  function listItem(episode) {
    const button = make("button");
    button.type = "button";
    button.dataset.number = String(episode.number);
    const name = make("span", "name");
    name.append(make("b", "", String(episode.number)), episode.id);
    button.append(name, make("span", `outcome ${episode.outcome}`, episode.outcome));
    button.append(make("span", "figures", figures(episode)));
    if (episode.turns.length) button.append(bars(episode.turns, false));
    button.title = episode.id;
    button.addEventListener("click", () => open(episode, true));
    const item = make("li");
    item.append(button);
    return item;
  }

  function options(select, all, values) {
    select.append(...[["", all], ...values.map((value) => [value, value])].map(([value, text]) => {
      const option = make("option", "", text);
      option.value = value;
      return option;
    }));
  }

  function onKey(event) {
    const typing = event.target instanceof HTMLInputElement || event.target instanceof HTMLSelectElement;
    if (event.key === "Escape") {
      document.body.classList.remove("reading");
      if (event.target === $("search") && $("search").value) { $("search").value = ""; filter(); }
      else if (typing) event.target.blur();
      return;
    }
    if (typing || event.ctrlKey || event.metaKey || event.altKey) return;
    const actions = {
      j: () => goToEpisode(1), k: () => goToEpisode(-1), n: () => goToTurn(turnAt + 1), p: () => goToTurn(turnAt - 1),
      ArrowRight: () => goToEpisode(1), ArrowLeft: () => goToEpisode(-1), "/": () => $("search").focus(),
    };
    if (Object.hasOwn(actions, event.key)) { event.preventDefault(); actions[event.key](); }
  }

  document.title = `${data.title} · episodes`;
  $("title").textContent = data.title;
  data.notes.forEach((note) => $("notes").append(make("div", "", note)));
  options($("env"), "all environments", [...new Set(episodes.map((episode) => episode.id))].sort());
  options($("outcome"), "all outcomes", [...new Set(episodes.map((episode) => episode.outcome))].sort());
  let waiting = 0;
  $("search").addEventListener("input", () => { clearTimeout(waiting); waiting = setTimeout(filter, 150); });
  for (const id of ["env", "outcome", "sort"]) $(id).addEventListener("change", filter);
  $("back").addEventListener("click", () => document.body.classList.remove("reading"));
  document.addEventListener("keydown", onKey);
  filter();
  const asked = episodes.find((episode) => `#${episode.number}` === location.hash);
  if (asked) open(asked, true);
})();
