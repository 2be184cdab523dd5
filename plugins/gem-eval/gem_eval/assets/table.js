"use strict";
// A table of any length: only the rows in sight are in the page, and only those near them have been fetched.
const virtualTable = (() => {
  const ROW_HEIGHT = 34;
  const ROWS_AT_ONCE = 100;
  const ROWS_AHEAD = 8;
  const PAGES_KEPT = 30;
  // Browsers draw no elements that are higher; longer tables scroll in larger steps.
  const MOST_PIXELS = 12_000_000;
  const SETTLED_MS = 40;

  // Rows by their place, fetched in pages: fetchRows(start, count) is a promise of {rows, total}.
  function remoteRows(fetchRows, changed) {
    let pages = new Map();
    let table = 0;
    let version = 0;
    let total = 0;
    let timer = 0;
    const asked = new Set();

    async function load(page) {
      const [ofTable, ofVersion] = [table, version];
      asked.add(page);
      let answer;
      try {
        answer = await fetchRows(page * ROWS_AT_ONCE, ROWS_AT_ONCE);
      } finally {
        if (ofTable === table) asked.delete(page);
      }
      if (ofTable !== table) return;
      total = answer.total;
      pages.delete(page);
      pages.set(page, { rows: answer.rows, fresh: ofVersion === version });
      while (pages.size > PAGES_KEPT) pages.delete(pages.keys().next().value);
      changed();
    }

    function want(first, last) {
      clearTimeout(timer);
      timer = setTimeout(() => {
        for (let page = Math.floor(first / ROWS_AT_ONCE); page <= Math.floor(Math.max(last, first) / ROWS_AT_ONCE); page += 1) {
          const known = pages.get(page);
          if ((!known || !known.fresh) && !asked.has(page)) load(page).catch(() => {});
        }
      }, pages.size ? SETTLED_MS : 0);
    }

    return {
      want,
      total: () => total,
      row: (place) => pages.get(Math.floor(place / ROWS_AT_ONCE))?.rows[place % ROWS_AT_ONCE],
      // Another table: nothing of the old one is shown.
      reset() { table += 1; asked.clear(); pages = new Map(); total = 0; },
      // The same table has changed: what is shown stays until it is there anew.
      refresh() { version += 1; pages.forEach((page) => { page.fresh = false; }); },
    };
  }

  function localRows(rows) {
    return { want() {}, total: () => rows.length, row: (place) => rows[place] };
  }

  // drawRow(data, place) returns the element of a row; data is undefined while it is fetched.
  function make({ scroller, space, body, drawRow }) {
    let source = localRows([]);
    let shown = new Map();

    // Where the scroller is too high for the browser, its share stands for that of the rows.
    function isLong() { return source.total() * ROW_HEIGHT > MOST_PIXELS; }
    function lastTop() { return Math.max(0, source.total() - Math.floor(scroller.clientHeight / ROW_HEIGHT)); }
    function topRow() {
      const share = scroller.scrollTop / Math.max(1, MOST_PIXELS - scroller.clientHeight);
      return Math.min(lastTop(), isLong() ? Math.round(share * lastTop()) : Math.floor(scroller.scrollTop / ROW_HEIGHT));
    }

    function draw() {
      const total = source.total();
      const height = scroller.clientHeight;
      const visible = Math.ceil(height / ROW_HEIGHT) + 1;
      space.style.height = `${Math.min(total * ROW_HEIGHT, MOST_PIXELS)}px`;
      const top = topRow();
      const first = Math.max(0, top - ROWS_AHEAD);
      const last = Math.min(total, top + visible + ROWS_AHEAD);
      if (!total || last > first) source.want(first, Math.max(last - 1, first));
      const next = new Map();
      for (let place = first; place < last; place += 1) {
        const data = source.row(place);
        const known = shown.get(place);
        next.set(place, known && known.data === data ? known : { data, element: drawRow(data, place) });
      }
      shown = next;
      body.replaceChildren(...[...next.values()].map((each) => each.element));
      const offset = isLong() ? scroller.scrollTop - (top - first) * ROW_HEIGHT : first * ROW_HEIGHT;
      body.style.transform = `translateY(${offset}px)`;
    }

    function reveal(place) {
      const rows = Math.floor(scroller.clientHeight / ROW_HEIGHT);
      const top = topRow();
      const wanted = place < top ? place : place >= top + rows ? place - rows + 1 : top;
      if (wanted !== top) {
        const share = wanted / Math.max(1, lastTop());
        scroller.scrollTop = isLong() ? share * (MOST_PIXELS - scroller.clientHeight) : wanted * ROW_HEIGHT;
      }
      draw();
    }

    let waiting = false;
    scroller.addEventListener("scroll", () => {
      if (waiting) return;
      waiting = true;
      requestAnimationFrame(() => { waiting = false; draw(); });
    });
    new ResizeObserver(() => draw()).observe(scroller);

    return {
      draw,
      reveal,
      redraw() { shown = new Map(); draw(); },
      use(other) { source = other; shown = new Map(); scroller.scrollTop = 0; draw(); },
      row: (place) => source.row(place),
      total: () => source.total(),
    };
  }

  return { make, remoteRows, localRows };
})();
