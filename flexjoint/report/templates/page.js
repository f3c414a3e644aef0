"use strict";
// What a reader does with the page: tables are sorted by a click on a head, plots are enlarged by a click and
// zoomed. The page is whole without it.
window.flexjoint = (() => {
  const make = (tag, kind, text = "") => Object.assign(document.createElement(tag), { className: kind, textContent: text });

  // --- tables -------------------------------------------------------------------------------------------
  // the first number of a cell: "0.0933 → 0.00934 rad" is 0.0933; NaN where there is none
  const numberIn = text => {
    const found = text.replace("−", "-").match(/-?\d+(\.\d+)?(e[-+]?\d+)?/i);
    return found ? Number(found[0]) : NaN;
  };

  const key = (row, column) => (row.cells[column].dataset.key ?? row.cells[column].textContent).trim();

  // ways: 1 from small to large, -1 from large to small, 0 as the page had it
  const sort = (table, column, way) => {
    const body = table.tBodies[0], rows = [...body.rows];
    rows.forEach((row, k) => { row.dataset.place ??= k; });
    const numbers = new Map(rows.map(row => [row, numberIn(key(row, column))]));
    const isText = column === 0 || ![...numbers.values()].some(value => !Number.isNaN(value));
    rows.sort((a, b) => {
      const place = a.dataset.place - b.dataset.place;
      if (way === 0) return place;
      if (isText) return way * key(a, column).localeCompare(key(b, column), "en", { numeric: true }) || place;
      const [x, y] = [numbers.get(a), numbers.get(b)];
      if (Number.isNaN(x) || Number.isNaN(y)) return Number.isNaN(x) - Number.isNaN(y) || place; // what is not known: last
      return way * (x - y) || place;
    });
    body.append(...rows);
    table.classList.toggle("sorted", way !== 0);
    [...table.tHead.rows[0].cells].forEach((cell, k) => {
      if (k === column && way !== 0) cell.setAttribute("aria-sort", way > 0 ? "ascending" : "descending");
      else cell.removeAttribute("aria-sort");
    });
  };

  const sortable = table => [...table.tHead.rows[0].cells].forEach((cell, column) => {
    if (cell.tagName !== "TH") return;
    const button = make("button", "head");
    button.type = "button";
    button.append(...cell.childNodes);
    cell.append(button);
    button.addEventListener("click", () => {
      const first = column === 0 ? 1 : -1; // names from a to z, numbers from the largest
      const now = { ascending: 1, descending: -1 }[cell.getAttribute("aria-sort")] ?? 0;
      sort(table, column, now === 0 ? first : now === first ? -first : 0);
    });
  });

  // --- plots --------------------------------------------------------------------------------------------
  const LEFT = 78, RIGHT = 16, TOP = 12, BOTTOM = 46, TICKS = 7;
  const DEEPEST = 1e-4; // of what the whole plot shows
  let shown = null; // the plot that is open: its whole and its present window, and where they are drawn

  const steps = (low, high, count) => {
    const raw = (high - low) / count, power = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].map(k => k * power).find(s => s >= raw * 0.999);
    const first = Math.ceil(low / step - 1e-9);
    return Array.from({ length: Math.floor(high / step + 1e-9) - first + 1 }, (_, k) => (first + k) * step);
  };
  // a number with the digits that tell it from its neighbour, `span` being what the axis shows
  const said = (value, span) => {
    const size = Math.max(Math.abs(value), span);
    if (Math.abs(value) < 1e-6 * span) return "0";
    if (size >= 1e5 || size < 1e-3) {
      const digits = Math.ceil(Math.log10(Math.abs(value) / span)) + 2;
      return value.toExponential(Math.max(0, Math.min(6, digits))).replace(/\.?0+e/, "e");
    }
    return String(Number(value.toFixed(Math.max(0, Math.min(9, 2 - Math.floor(Math.log10(span)))))));
  };

  const parsed = image => {
    const data = atob(image.src.slice(image.src.indexOf(",") + 1));
    const bytes = Uint8Array.from(data, letter => letter.charCodeAt(0));
    const svg = new DOMParser().parseFromString(new TextDecoder().decode(bytes), "image/svg+xml").documentElement;
    // its own axes and style go: axes are drawn anew for each window, and a style would be the whole page's
    svg.querySelectorAll("style, metadata, [id^='matplotlib.axis']").forEach(node => node.remove());
    return svg;
  };

  const open = image => {
    const [x0, x1, y0, y1, left, right, top, bottom] = image.dataset.axes.split(" ").map(Number);
    const dialog = make("dialog", "zoom"), bar = make("div", "bar-of-zoom"), stage = make("div", "stage");
    const readout = make("output", ""), whole = make("button", "", "whole"), close = make("button", "", "close");
    bar.append(make("strong", "", image.alt), readout, whole, close);
    const legend = image.closest("section")?.querySelector(".legend")?.cloneNode(true);
    legend?.querySelector(".live")?.remove();
    const touched = matchMedia("(pointer: coarse)").matches;
    const hint = make("p", "reference", touched ? "Two fingers zoom, one moves." :
      "Drag a box to zoom into it. Wheel, + and -: zoom. Arrows: move. Double click or 0: the whole plot. Esc: close.");
    dialog.append(bar, ...(legend ? [legend] : []), stage, hint);
    const svg = document.importNode(parsed(image), true), space = svg.namespaceURI;
    const outer = document.createElementNS(space, "svg"), grid = document.createElementNS(space, "g");
    const box = document.createElementNS(space, "rect");
    svg.setAttribute("preserveAspectRatio", "none");
    outer.append(grid, svg, box);
    stage.append(outer);
    const full = svg.viewBox.baseVal;
    shown = {
      dialog, stage, outer, svg, grid, box, readout, image, space,
      all: [x0, x1, y0, y1], view: [x0, x1, y0, y1],
      area: [left * full.width, right * full.width, (1 - top) * full.height, (1 - bottom) * full.height],
      fingers: new Map(),
    };
    whole.addEventListener("click", () => show(shown.all));
    close.addEventListener("click", () => dialog.close());
    dialog.addEventListener("close", () => { dialog.remove(); shown = null; image.focus(); });
    listen(stage);
    dialog.addEventListener("keydown", pressed);
    document.body.append(dialog);
    dialog.showModal();
    show(shown.all);
  };

  const size = () => {
    const { width, height } = shown.stage.getBoundingClientRect();
    return [Math.max(width - LEFT - RIGHT, 20), Math.max(height - TOP - BOTTOM, 20)];
  };

  // the plot with this window [x0, x1, y0, y1], kept within the whole
  const show = window_ => {
    const view = [...window_];
    for (const k of [0, 2]) {
      const [low, high] = [shown.all[k], shown.all[k + 1]], least = DEEPEST * (high - low);
      let span = Math.min(Math.max(view[k + 1] - view[k], least), high - low);
      const start = Math.min(Math.max(0.5 * (view[k] + view[k + 1] - span), low), high - span);
      [view[k], view[k + 1]] = [start, start + span];
    }
    shown.view = view;
    const [width, height] = size(), [x0, x1, y0, y1] = view, { svg, outer, grid, area, all, space } = shown;
    const scaleX = (area[1] - area[0]) / (all[1] - all[0]), scaleY = (area[3] - area[2]) / (all[3] - all[2]);
    outer.setAttribute("width", width + LEFT + RIGHT);
    outer.setAttribute("height", height + TOP + BOTTOM);
    const place = { x: LEFT, y: TOP, width, height };
    for (const name in place) svg.setAttribute(name, place[name]);
    svg.setAttribute("viewBox", [
      area[0] + (x0 - all[0]) * scaleX, area[2] + (all[3] - y1) * scaleY, (x1 - x0) * scaleX, (y1 - y0) * scaleY,
    ].join(" "));
    const line = (xa, ya, xb, yb) => {
      const node = document.createElementNS(space, "line");
      Object.entries({ x1: xa, y1: ya, x2: xb, y2: yb }).forEach(([name, value]) => node.setAttribute(name, value));
      return node;
    };
    const word = (text, x, y, anchor, turn = 0) => {
      const node = document.createElementNS(space, "text");
      node.textContent = text;
      node.setAttribute("text-anchor", anchor);
      node.setAttribute("transform", `translate(${x} ${y}) rotate(${turn})`);
      return node;
    };
    const few = Math.max(2, Math.min(TICKS, Math.floor(width / 80)));
    grid.replaceChildren(
      ...steps(x0, x1, few).flatMap(value => {
        const x = LEFT + (value - x0) / (x1 - x0) * width;
        return [line(x, TOP, x, TOP + height), word(said(value, x1 - x0), x, TOP + height + 17, "middle")];
      }),
      ...steps(y0, y1, Math.max(2, Math.min(TICKS, Math.floor(height / 40)))).flatMap(value => {
        const y = TOP + (y1 - value) / (y1 - y0) * height;
        return [line(LEFT, y, LEFT + width, y), word(said(value, y1 - y0), LEFT - 6, y + 4, "end")];
      }),
      word(shown.image.dataset.x, LEFT + width / 2, TOP + height + 38, "middle"),
      word(shown.image.dataset.y, 14, TOP + height / 2, "middle", -90),
    );
  };

  const zoom = (factor, at = [0.5, 0.5]) => {
    const [x0, x1, y0, y1] = shown.view, [u, v] = at;
    const x = x0 + u * (x1 - x0), y = y0 + v * (y1 - y0);
    show([x + (x0 - x) * factor, x + (x1 - x) * factor, y + (y0 - y) * factor, y + (y1 - y) * factor]);
  };
  const move = (u, v) => {
    const [x0, x1, y0, y1] = shown.view, dx = u * (x1 - x0), dy = v * (y1 - y0);
    show([x0 + dx, x1 + dx, y0 + dy, y1 + dy]);
  };
  // where a pointer is, as a share of the axes from the lower left
  const where = event => {
    const edge = shown.stage.getBoundingClientRect(), [width, height] = size();
    return [(event.clientX - edge.left - LEFT) / width, 1 - (event.clientY - edge.top - TOP) / height];
  };

  const pressed = event => {
    const does = {
      "+": () => zoom(0.7), "=": () => zoom(0.7), "-": () => zoom(1 / 0.7), 0: () => show(shown.all),
      ArrowLeft: () => move(-0.2, 0), ArrowRight: () => move(0.2, 0), ArrowUp: () => move(0, 0.2), ArrowDown: () => move(0, -0.2),
    }[event.key];
    if (does && !event.ctrlKey && !event.metaKey) { does(); event.preventDefault(); }
  };

  const boxed = (from, to) => {
    const [width, height] = size(), { box } = shown;
    const clip = value => Math.min(Math.max(value, 0), 1);
    const [u0, u1] = [from[0], to[0]].map(clip).sort((a, b) => a - b);
    const [v0, v1] = [from[1], to[1]].map(clip).sort((a, b) => a - b);
    const place = { x: LEFT + u0 * width, y: TOP + (1 - v1) * height, width: (u1 - u0) * width, height: (v1 - v0) * height };
    for (const name in place) box.setAttribute(name, place[name]);
    return [u0, u1, v0, v1];
  };

  const listen = stage => {
    stage.addEventListener("wheel", event => {
      event.preventDefault();
      zoom(Math.exp(0.0015 * event.deltaY), where(event));
    }, { passive: false });
    stage.addEventListener("dblclick", () => show(shown.all));
    stage.addEventListener("pointerdown", event => {
      stage.setPointerCapture(event.pointerId);
      shown.fingers.set(event.pointerId, where(event));
      if (event.pointerType === "mouse") shown.from = where(event);
    });
    stage.addEventListener("pointermove", event => {
      const at = where(event), before = shown.fingers.get(event.pointerId), [x0, x1, y0, y1] = shown.view;
      const value = [x0 + at[0] * (x1 - x0), y0 + at[1] * (y1 - y0)];
      shown.readout.textContent = `${said(value[0], x1 - x0)}, ${said(value[1], y1 - y0)}`;
      if (!before) return;
      if (shown.from) { boxed(shown.from, at); return; }
      const others = [...shown.fingers].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
      const apart = (a, b) => Math.max(Math.hypot(a[0] - b[0], a[1] - b[1]), 0.02);
      if (others.length) zoom(apart(before, others[0]) / apart(at, others[0]), others[0]);
      else move(before[0] - at[0], before[1] - at[1]);
      shown.fingers.set(event.pointerId, at);
    });
    const end = event => {
      shown.fingers.delete(event.pointerId);
      if (!shown.from) return;
      const [u0, u1, v0, v1] = boxed(shown.from, where(event)), [x0, x1, y0, y1] = shown.view;
      shown.from = null;
      boxed([0, 0], [0, 0]);
      if (event.type === "pointerup" && u1 - u0 > 0.01 && v1 - v0 > 0.01)
        show([x0 + u0 * (x1 - x0), x0 + u1 * (x1 - x0), y0 + v0 * (y1 - y0), y0 + v1 * (y1 - y0)]);
    };
    stage.addEventListener("pointerup", end);
    stage.addEventListener("pointercancel", end);
  };

  // --- the page -----------------------------------------------------------------------------------------
  document.documentElement.classList.add("scripted");
  document.querySelectorAll("table").forEach(table => { if (table.tHead) sortable(table); });
  document.querySelectorAll("img[data-axes]").forEach(image => {
    Object.assign(image, { tabIndex: 0, title: "enlarge" });
    image.setAttribute("role", "button");
    image.addEventListener("click", () => open(image));
    image.addEventListener("keydown", event => {
      if (event.key === "Enter" || event.key === " ") { event.preventDefault(); open(image); }
    });
  });
  addEventListener("resize", () => { if (shown) show(shown.view); });
  // what is folded away is printed, too
  const folded = [];
  addEventListener("beforeprint", () => {
    if (shown) shown.dialog.close();
    document.querySelectorAll("details:not([open])").forEach(node => { node.open = true; folded.push(node); });
  });
  addEventListener("afterprint", () => { while (folded.length) folded.pop().open = false; });
  return { sort, open, show: window_ => show(window_), zoom, view: () => shown?.view ?? null };
})();
