  // The plot, the table and the pictures of a bench; `data` is what page.py put in.
  const svg = at("plot"), tip = at("tip");
  const box = { left: 78, right: 980, top: 18, bottom: 505 };
  const color = method => data.colors[data.methods.indexOf(method) % data.colors.length];
  const own = () => data.points.filter(p => p.scene === at("scene").value);

  function options(select, names, chosen) {
    select.replaceChildren(...names.map(name => new Option(name, name)));
    if (names.includes(chosen)) select.value = chosen;
  }
  function errorOf(p) {
    const kind = at("error").value, e = p.errors[kind];
    if (!e) return null;
    return (kind === "ssim" ? [1 - e[0], 1 - e[2], 1 - e[1]] : e).map(v => Math.max(v, 1e-6));
  }
  const text = seconds => seconds >= 1 ? `${+seconds.toPrecision(3)} s` : `${+(1000 * seconds).toPrecision(3)} ms`;

  function node(name, attributes, content) {
    const made = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const key in attributes) made.setAttribute(key, attributes[key]);
    if (content !== undefined) made.textContent = content;
    svg.append(made);
    return made;
  }
  function scale(values, from, to) {
    const low = Math.log10(Math.min(...values)), high = Math.log10(Math.max(...values));
    const pad = 0.05 * Math.max(high - low, 0.3);
    const map = v => from + (Math.log10(v) - low + pad) / (high - low + 2 * pad) * (to - from);
    const series = (high - low) > 1.7 ? [1] : [1, 2, 5];
    map.ticks = [];
    for (let e = Math.floor(low - pad); e <= Math.ceil(high + pad); e++)
      for (const m of series) {
        const v = +`${m}e${e}`;
        if (Math.log10(v) >= low - pad && Math.log10(v) <= high + pad) map.ticks.push(v);
      }
    return map;
  }

  function draw() {
    svg.replaceChildren();
    tip.hidden = true;
    const kind = at("time").value;
    const shown = own().filter(p => p.seconds[kind] && errorOf(p));
    at("legend").replaceChildren(...data.methods.map(method => {
      const entry = document.createElement("span"), dot = document.createElement("i");
      dot.style.background = color(method);
      entry.append(dot, method);
      return entry;
    }));
    if (!shown.length) {
      node("text", { x: 500, y: 280, "text-anchor": "middle" }, "Nothing with this time and error was measured here.");
      return;
    }
    const x = scale(shown.map(p => p.seconds[kind]), box.left, box.right);
    const y = scale(shown.flatMap(p => errorOf(p)), box.bottom, box.top);
    const limit = data.flagged[at("scene").value];
    if (limit && at("error").value === "rell2" && y(limit) < box.bottom)
      node("rect", { x: box.left, y: Math.max(y(limit), box.top), width: box.right - box.left,
        height: box.bottom - Math.max(y(limit), box.top), fill: "#0001" });
    for (const v of x.ticks) {
      node("line", { x1: x(v), x2: x(v), y1: box.top, y2: box.bottom, stroke: "#e4e8ea" });
      node("text", { x: x(v), y: box.bottom + 20, "text-anchor": "middle" }, v);
    }
    for (const v of y.ticks) {
      node("line", { x1: box.left, x2: box.right, y1: y(v), y2: y(v), stroke: "#e4e8ea" });
      node("text", { x: box.left - 8, y: y(v) + 4, "text-anchor": "end" }, v);
    }
    const label = select => select.selectedOptions[0].textContent;
    node("text", { x: (box.left + box.right) / 2, y: 548, "text-anchor": "middle" }, label(at("time")) + " time (s)");
    node("text", { transform: `translate(18 ${(box.top + box.bottom) / 2}) rotate(-90)`, "text-anchor": "middle" }, label(at("error")));

    const front = [];
    for (const p of [...shown].sort((a, b) => a.seconds[kind] - b.seconds[kind] || errorOf(a)[0] - errorOf(b)[0]))
      if (!front.length || errorOf(p)[0] < errorOf(front.at(-1))[0]) front.push(p);
    node("path", { fill: "none", stroke: "#c8c8c8", "stroke-width": 4, d: front.map((p, i) =>
      (i ? `H${x(p.seconds[kind])}V` : `M${x(p.seconds[kind])} `) + y(errorOf(p)[0])).join("") });
    for (const method of data.methods) {
      const curve = shown.filter(p => p.method === method);
      node("polyline", { fill: "none", stroke: color(method), "stroke-width": 2,
        points: curve.map(p => `${x(p.seconds[kind])},${y(errorOf(p)[0])}`).join(" ") });
      for (const p of curve) {
        const [mean, low, high] = errorOf(p), cx = x(p.seconds[kind]);
        node("line", { x1: cx, x2: cx, y1: y(low), y2: y(high), stroke: color(method) });
        if (front.includes(p)) node("circle", { cx, cy: y(mean), r: 9, fill: "none", stroke: "#888" });
        const dot = node("circle", { cx, cy: y(mean), r: 5.5, fill: color(method), class: "point" });
        dot.addEventListener("pointerenter", () => hover(p, cx, y(mean)));
        dot.addEventListener("pointerleave", () => { tip.hidden = true; });
        dot.addEventListener("click", event => choose(p, event.shiftKey ? "before" : "after"));
      }
    }
  }
  function hover(p, cx, cy) {
    const [mean, low, high] = errorOf(p), kind = at("error").selectedOptions[0].textContent;
    const times = Object.entries(p.seconds).map(([name, s]) => `${name} ${text(s)}`).join(", ");
    tip.textContent = `${p.method}, ${p.spp} spp\n${kind} ${+mean.toPrecision(3)} (${+low.toPrecision(3)} to ${+high.toPrecision(3)})\n${times}`;
    const width = svg.getBoundingClientRect().width;
    tip.hidden = false;
    const half = tip.offsetWidth / 2;
    tip.style.left = Math.min(Math.max(cx / 1000 * width, half), width - half) + "px";
    tip.style.top = Math.max(cy / 1000 * width, tip.offsetHeight + 12) + "px";
  }
  function advise() {
    const budget = +at("budget").value, kind = at("time").value;
    const fitting = own().filter(p => p.seconds[kind] <= budget && errorOf(p));
    fitting.sort((a, b) => errorOf(a)[0] - errorOf(b)[0]);
    const best = fitting[0];
    at("advice").textContent = !budget ? "" : !best ? "Nothing that was measured is so fast." :
      `Take ${best.method} at ${best.spp} spp: ${at("error").selectedOptions[0].textContent} ${+errorOf(best)[0].toPrecision(3)} in ${text(best.seconds[kind])}.`;
  }

  let sorted = [1, 1]; // column, direction
  const number = cell => parseFloat(cell.replaceAll(",", ""));
  function fill() {
    const rows = own().map(p => p.row), [column, direction] = sorted;
    rows.sort((a, b) => {
      const [m, n] = [number(a[column]), number(b[column])];
      if (isNaN(m) && isNaN(n)) return direction * a[column].localeCompare(b[column]);
      return isNaN(m) ? 1 : isNaN(n) ? -1 : direction * (m - n); // what is empty comes last
    });
    at("table").tBodies[0].replaceChildren(...rows.map(row => {
      const line = document.createElement("tr");
      for (const cell of row) line.insertCell().textContent = cell;
      return line;
    }));
    at("table").querySelectorAll("th").forEach((head, index) => {
      if (index === column) head.setAttribute("aria-sort", direction > 0 ? "ascending" : "descending");
      else head.removeAttribute("aria-sort");
    });
  }
  at("table").querySelectorAll("th button").forEach((button, index) => button.addEventListener("click", () => {
    sorted = [index, index === sorted[0] ? -sorted[1] : 1];
    fill();
  }));

  const pictures = Object.keys(data.views);
  const named = view => view.spp ? `${view.method}, ${view.spp} spp` : view.method;
  const viewOf = side => data.views[at("pick-scene").value].find(v => named(v) === at("pick-" + side).value);
  function show() {
    for (const side of ["before", "after"]) {
      const view = viewOf(side);
      at(side).src = at("maps").checked ? view.error : view.image;
      at(side).alt = at("tag-" + side).textContent = named(view);
      at("stage").style.setProperty("--aspect", view.size.join(" / "));
    }
  }
  function pickScene(before, after) {
    const all = data.views[at("pick-scene").value].map(named);
    options(at("pick-before"), all, before ?? at("pick-before").value);
    options(at("pick-after"), all, after ?? at("pick-after").value);
    show();
  }
  function choose(p, side) {
    const scene = p.scene === data.all ? at("pick-scene")?.value : p.scene;
    if (!data.views[scene]?.some(v => named(v) === named(p))) {
      tip.textContent += "\n(its picture is not on this page)";
      return;
    }
    at("pick-scene").value = scene;
    pickScene();
    at("pick-" + side).value = named(p);
    show();
  }
  if (pictures.length) {
    options(at("pick-scene"), pictures);
    const first = data.views[pictures[0]], last = first.filter(v => v.spp);
    pickScene(last.length ? named(last[0]) : "reference", last.length > 1 ? named(last[1]) : "reference");
    for (const id of ["pick-before", "pick-after", "maps"]) at(id).addEventListener("change", show);
    at("pick-scene").addEventListener("change", () => pickScene());
    makeSlider(() => {});
  }

  options(at("scene"), data.scenes);
  at("scene").addEventListener("change", () => {
    if (pictures.includes(at("scene").value)) {
      at("pick-scene").value = at("scene").value;
      pickScene();
    }
    fill();
  });
  for (const id of ["scene", "error", "time"]) at(id).addEventListener("change", () => { draw(); advise(); });
  at("budget").addEventListener("input", advise);
  draw();
  fill();
