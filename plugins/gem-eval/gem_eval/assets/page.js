(() => {
  const { make, bars, draw, figures } = transcripts;
  const data = JSON.parse(document.getElementById("data").textContent);
  const $ = (id) => document.getElementById(id);
  const episodes = data.episodes;
  let shown = [];
  let current = null;
  let drawn = null;

  function imageSource(name) { return Object.hasOwn(data.images, name) ? data.images[name] : null; }

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

  function open(episode, moveFocus) {
    current = episode;
    drawn = null;
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
    drawn = draw(article, episode, { wanted: query(), imageSource });
    if (moveFocus) {
      document.body.classList.add("reading");
      document.querySelector("main").scrollTop = 0;
      history.replaceState(null, "", `#${episode.number}`);
    }
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
      j: () => goToEpisode(1), k: () => goToEpisode(-1), n: () => drawn && drawn.nextTurn(1), p: () => drawn && drawn.nextTurn(-1),
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
