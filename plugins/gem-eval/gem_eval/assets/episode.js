"use strict";
// Draws one episode. All text of others goes through textContent: nothing of it is ever read as HTML.
const transcripts = (() => {
  const LONG = 6000;
  const BEGINNING = 5000;
  const CARDS_AT_ONCE = 25;
  // What a browser would obey or not show; the same as in the texts that Python has escaped.
  const UNSAFE = /[\x00-\x08\x0b-\x1f\x7f-\x9f\xad\u061c\u180e\u200b\u200e\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb\ud800-\udfff\u{e0000}-\u{e0fff}]/gu;

  function make(tag, className, text) {
    const element = document.createElement(tag);
    if (className) element.className = className;
    if (text !== undefined) element.textContent = text;
    return element;
  }

  function visible(text) {
    return text.replace(UNSAFE, (found) => {
      const code = found.codePointAt(0).toString(16);
      return code.length <= 2 ? `\\x${code.padStart(2, "0")}` : `\\u${code.padStart(4, "0")}`;
    });
  }

  function textInto(element, text, wanted) {
    const lower = text.toLowerCase();
    // Where lower case is longer than the text, places would not fit.
    if (!wanted || lower.length !== text.length) { element.append(text); return element; }
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

  const count = (number, noun) => `${number.toLocaleString("en")} ${noun}${number === 1 ? "" : "s"}`;

  function svgElement(tag, attributes) {
    const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
    for (const name of Object.keys(attributes)) element.setAttribute(name, String(attributes[name]));
    return element;
  }

  function bars(turns, large, onTurn) {
    const most = Math.max(...turns.map((turn) => turn.reward), 0);
    const least = Math.min(...turns.map((turn) => turn.reward), 0);
    const span = most - least || 1;
    const places = Math.max(turns.length, 1);
    const step = large ? Math.max(4, Math.min(28, Math.floor(860 / places))) : Math.min(6, 96 / places);
    const height = large ? 44 : 14;
    const zero = most === least ? height - 2 : (height - 2) * (most / span) + 1;
    const svg = svgElement("svg", {
      class: large ? "bars large" : "bars", viewBox: `0 0 ${step * places} ${height}`, width: step * places, height, preserveAspectRatio: "none", role: "img",
      "aria-label": `Rewards: ${turns.slice(0, 100).map((turn) => turn.rewardText).join(", ")}`,
    });
    turns.forEach((turn, place) => {
      const tall = turn.reward === 0 ? 2 : Math.max((Math.abs(turn.reward) / span) * (height - 2), 2);
      const top = turn.reward > 0 ? zero - tall : turn.reward < 0 ? zero : Math.min(zero, height - 2);
      const kind = turn.reward > 0 ? "plus" : turn.reward < 0 ? "minus" : "zero";
      const width = step > 3 ? step - 2 : step * 0.8;
      svg.append(svgElement("rect", { x: place * step, y: top, width, height: tall, class: kind }));
      if (!large) return;
      const hit = svgElement("rect", { x: place * step, y: 0, width: step, height, class: "hit" });
      const title = svgElement("title", {});
      title.textContent = `turn ${turn.number}: reward ${turn.rewardText}`;
      hit.append(title);
      hit.addEventListener("click", () => onTurn(place));
      svg.append(hit);
    });
    return svg;
  }

  // Options: wanted (text to mark, in lower case), imageSource (name => URL or null).
  function drawer(options) {
    const { wanted, imageSource } = options;
    const holds = (text) => Boolean(wanted) && text.toLowerCase().includes(wanted);

    function longText(text, className) {
      const pre = make("pre", className);
      if (text.length <= LONG) return textInto(pre, text, wanted);
      const element = make("div");
      element.append(pre);
      if (holds(text.slice(BEGINNING - wanted.length))) { textInto(pre, text, wanted); return element; }
      textInto(pre, text.slice(0, BEGINNING), wanted);
      const button = make("button", "all", `Show all ${count(text.length, "character")}`);
      button.type = "button";
      button.addEventListener("click", () => {
        pre.replaceChildren();
        textInto(pre, text, wanted);
        button.remove();
      });
      element.append(button);
      return element;
    }

    function folded(summary, className, elements, isOpen) {
      const details = make("details", className);
      details.append(make("summary", "", summary), ...elements);
      details.open = isOpen;
      return details;
    }

    function part(each, className) {
      const source = each.kind === "image" ? imageSource(each.text) : null;
      if (source === null) {
        if (each.kind === "image") return textInto(make("pre", "dim"), `[image ${each.text}]`, wanted);
        return longText(each.text, each.kind === "role" ? "role" : each.kind === "text" ? className : "dim");
      }
      const image = make("img");
      image.addEventListener("load", () => { if (image.naturalWidth < 128) image.className = "small"; });
      image.addEventListener("error", () => image.replaceWith(make("pre", "dim", `[image ${each.text}: it cannot be shown]`)));
      image.src = source;
      image.alt = `image ${each.text.slice(0, 12)}`;
      return image;
    }

    function parts(block, all) {
      const repeated = all.filter((each) => each.repeated);
      if (repeated.length) {
        const length = repeated.reduce((sum, each) => sum + each.text.length, 0);
        const summary = `${count(length, "character")} as in the turn before`;
        block.append(folded(summary, "", repeated.map((each) => part(each, "dim")), repeated.some((each) => holds(each.text))));
      }
      all.filter((each) => !each.repeated).forEach((each) => block.append(part(each, "")));
      return block;
    }

    function block(label, className, aside) {
      const element = make("div", `block ${className}`);
      const head = make("div", "label", label);
      if (aside) head.append(textInto(make("span"), aside, wanted));
      element.append(head);
      return element;
    }

    function textBlock(label, value, className, aside) {
      const element = block(label, className, aside);
      element.append(value ? longText(value, "") : make("pre", "dim", "(empty)"));
      return element;
    }

    function thinking(value) {
      return folded(`Thinking, ${count(value.length, "character")}`, "thinking", [longText(value, "")], holds(value));
    }

    function response(text, aside) {
      const end = text.indexOf("</think>");
      if (end < 0) return textBlock("Response", text, "said", aside);
      const element = block("Response", "said", aside);
      element.append(thinking(text.slice(0, end).replace(/^\s*<think>/, "").trim()));
      const rest = text.slice(end + "</think>".length).trim();
      element.append(rest ? longText(rest, "") : make("pre", "dim", "(nothing after the thinking)"));
      return element;
    }

    function toolCall(call) {
      const found = /^([\w.:-]{1,100})\((\{[^]*\})\)$/.exec(call);
      let values = null;
      try { values = found && JSON.parse(found[2]); } catch { values = null; }
      if (!values) return textBlock("Tool call", call, "said call");
      const element = block("Tool call", "said call");
      element.append(textInto(make("b"), found[1], wanted));
      for (const name of Object.keys(values)) {
        const value = values[name];
        element.append(textInto(make("div", "argument"), visible(name), wanted));
        element.append(longText(visible(typeof value === "string" ? value : JSON.stringify(value)), ""));
      }
      return element;
    }

    function facts(values) {
      const list = make("dl", "facts");
      for (const name of Object.keys(values)) {
        const value = make("dd");
        if (values[name].length <= LONG) textInto(value, values[name], wanted);
        else value.append(longText(values[name], ""));
        list.append(make("dt", "", name), value);
      }
      return list;
    }

    function turnCard(turn, turns) {
      const card = make("section", "turn");
      const head = make("header");
      head.append(make("h3", "", `Turn ${turn.number} of ${turns}${turn.seat ? ` · ${turn.seat}` : ""}`));
      turn.flags.forEach((flag) => head.append(make("span", "flag", flag)));
      const sign = turn.reward > 0 ? " success" : turn.reward < 0 ? " failure" : "";
      head.append(make("span", `reward${sign}`, `reward ${turn.rewardText}`));
      card.append(head, ...[...turn.blocks, ...turn.answer].map(blockElement));
      if (Object.keys(turn.info).length) {
        const element = block("Info", "");
        element.append(facts(turn.info));
        card.append(element);
      }
      return card;
    }

    function blockElement({ label, parts: all, aside }) {
      const value = all.length ? all[0].text : "";
      if (label === "response") return response(value, aside);
      if (label === "tool call") return toolCall(value);
      if (label === "error") return textBlock("Error", value, "error");
      if (label !== "reasoning") return parts(block(label[0].toUpperCase() + label.slice(1), ""), all);
      const element = block("Reasoning", "said");
      element.append(thinking(value));
      return element;
    }

    function lastCard(label, all, error) {
      const card = make("section", "turn");
      card.append(parts(block(label, ""), all));
      if (error) card.append(textBlock("Error", error, "error"));
      return card;
    }

    return { facts, turnCard, lastCard };
  }

  function figures(episode) {
    return `${episode.returns || `return ${episode.return}`} · ${count(episode.count, "turn")}`;
  }

  // Draws an episode into an element; returns what goes to a turn. What is long is drawn piece by piece.
  function draw(article, episode, options) {
    const { facts, turnCard, lastCard } = drawer(options);
    let at = -1;
    let drawn = 0;
    const head = make("div", "head");
    head.append(make("h2", "", `${episode.number} · ${episode.id}`));
    const line = make("div");
    line.append(make("span", `outcome ${episode.outcome}`, episode.outcome), make("span", "figures", ` · ${figures(episode)}`));
    head.append(line);
    if (episode.turns.some((turn) => turn.reward !== 0)) head.append(bars(episode.turns, true, (place) => goToTurn(place)));
    head.append(facts(episode.start));
    article.replaceChildren(head);
    if (episode.observation.length) article.append(lastCard("Observation", episode.observation, ""));
    const first = article.childElementCount;

    function drawMore(upTo) {
      for (; drawn < Math.min(upTo, episode.turns.length); drawn += 1) article.append(turnCard(episode.turns[drawn], episode.count));
      if (drawn === episode.turns.length) {
        article.append(lastCard("Final observation", episode.final, episode.error ? episode.error : ""));
        drawn = Infinity;
      }
    }

    function drawLater() {
      // Another episode may have taken the place of this one.
      if (drawn === Infinity || head.parentElement !== article) return;
      drawMore(drawn + CARDS_AT_ONCE);
      setTimeout(drawLater);
    }

    function goToTurn(place) {
      drawMore(place + 2);
      const cards = [...article.children].slice(first);
      at = Math.max(0, Math.min(cards.length - 1, place));
      cards.forEach((card, number) => card.classList.toggle("here", number === at));
      // Cards out of sight have an estimated height, which is found out as they come into sight.
      const card = cards[at];
      card.scrollIntoView({ block: "start" });
      requestAnimationFrame(() => { card.scrollIntoView({ block: "start" }); requestAnimationFrame(() => card.scrollIntoView({ block: "start" })); });
    }

    drawMore(CARDS_AT_ONCE);
    setTimeout(drawLater);
    article.scrollTop = 0;
    return { goToTurn, nextTurn: (by) => goToTurn(at + by), turn: () => at, drawAll: () => drawMore(Infinity) };
  }

  return { make, textInto, bars, figures, draw, count };
})();
