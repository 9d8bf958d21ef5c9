"use strict";
(async () => {
  const stage = document.getElementById("stage");
  const facts = JSON.parse(document.getElementById("plot-facts").textContent);
  const LEFT = 54, RIGHT = 8;  // pixels beside every frame, so that all times stand in line
  const RATE_HIGH = 150, RESIDUAL_HIGH = 130;
  const FEW = 0.005, FLATTENED = 25;
  const LEAST_S = 10 * facts.step;  // narrower than this nothing can be told apart

  const inflated = async (id) => {
    const text = atob(document.getElementById(id).textContent.trim());
    const bytes = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i += 1) bytes[i] = text.charCodeAt(i);
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  };

  const library = async () => {
    if (window.Bokeh) return;  // a script file that reports share
    const script = document.createElement("script");
    script.textContent = new TextDecoder().decode(await inflated("plot-library"));
    document.head.append(script);  // runs at once; the page's policy knows its hash
  };

  const unpacked = (bytes) => {
    let at = 0;
    return facts.arrays.map(([kind, n]) => {
      const words = new Uint32Array(n);
      for (let i = 0; i < n; i += 1)
        words[i] = bytes[at + i] | bytes[at + n + i] << 8 | bytes[at + 2 * n + i] << 16
          | bytes[at + 3 * n + i] << 24;
      at += 4 * n;
      if (kind === "value") return new Float32Array(words.buffer);
      const times = new Float64Array(n);
      let ticks = 0;
      for (let i = 0; i < n; i += 1) {
        ticks += words[i];
        times[i] = facts.span[0] + ticks * facts.step;
      }
      return times;
    });
  };

  // As on paper: linear up to twice the tolerance, logarithmic beyond; between -1 and 1.
  const knee = 2 * facts.tolerance;
  const placed = (rate) => {
    const size = Math.abs(rate);
    if (facts.top <= 2 * knee) return rate / facts.top;
    const share = 0.5 * Math.min(size / knee, 1)
      + 0.5 * Math.log(Math.max(size, knee) / knee) / Math.log(facts.top / knee);
    return Math.sign(rate) * Math.min(share, 1.5);
  };

  // Each point from its least to its greatest value and on to the next: one line shows both.
  const zigzag = (line, scale) => {
    const n = line.t.length, x = new Float64Array(2 * n), y = new Float64Array(2 * n);
    for (let i = 0; i < n; i += 1) {
      x[2 * i] = x[2 * i + 1] = line.t[i];
      y[2 * i] = scale(line.low[i]);
      y[2 * i + 1] = scale(line.high[i]);
    }
    return { x, y };
  };

  const nearest = (times, time) => {
    let low = 0, high = times.length - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (times[middle] > time) high = middle; else low = middle;
    }
    return Math.abs(times[low] - time) <= Math.abs(times[high] - time) ? low : high;
  };

  const number = (value) => {
    const size = Math.abs(value);
    const text = size >= 1e6 ? value.toExponential(2) : value.toFixed(size >= 100 ? 0 : size >= 10 ? 1 : 2);
    return text.replace("-", "\u2212");
  };
  const range = (line, time, reach = Infinity) => {
    if (!line.t.length) return "";
    const i = nearest(line.t, time);
    if (Number.isNaN(line.low[i]) || Math.abs(line.t[i] - time) > reach) return "no data";
    const low = number(line.low[i]), high = number(line.high[i]);
    return low === high ? low : `${low} to ${high}`;
  };

  const made = (tag, kind, text) => {
    const element = document.createElement(tag);
    if (kind) element.className = kind;
    if (text !== undefined) element.textContent = text;
    return element;
  };

  const download = document.getElementById("download");
  if (download) {
    const result = document.getElementById("result").textContent;
    download.href = URL.createObjectURL(new Blob([result], { type: "application/json" }));
  }

  try {
    const [lines] = await Promise.all([inflated("plot-lines"), library()]);
    draw(unpacked(lines));
    document.documentElement.classList.add("drawn");
  } catch (error) {
    // The pictures that need no script stay.
    console.error("the plots could not be drawn:", error);
  }

  function draw(arrays) {
    const B = window.Bokeh;
    B.set_log_level("warn");
    const lineOf = (at) => at && { t: arrays[at.t], low: arrays[at.low], high: arrays[at.high] };
    const channels = facts.channels.map((channel) => ({ ...channel, ...lineOf(channel) }));
    const sources = [...new Set(channels.map((channel) => channel.source))];
    const x_range = new B.Range1d({ start: facts.span[0], end: facts.span[1] });
    const plots = [], readers = [], painted = [], rates = [];
    const touch = matchMedia("(pointer: coarse)").matches;

    // A model's colours follow the page's, by the name of a property of the style sheet.
    const paint = (model, colours) => painted.push([model, colours]);
    const repaint = () => {
      const style = getComputedStyle(document.documentElement), known = new Map();
      const colour = (name) => {
        if (!known.has(name)) known.set(name, style.getPropertyValue(name).trim());
        return known.get(name);
      };
      for (const [model, colours] of painted)
        model.setv(Object.fromEntries(Object.entries(colours).map(([of, name]) => [of, colour(name)])));
    };

    const plot = (height, y_range) => {
      const figure = new B.Plotting.Figure({
        x_range, y_range, height, sizing_mode: "stretch_width", toolbar_location: null,
        tools: [], min_border_left: LEFT, min_border_right: RIGHT, min_border_top: 3,
        min_border_bottom: 20, background_fill_alpha: 0, border_fill_alpha: 0,
        lod_threshold: null,
      });
      if (!touch) {
        const zoom = new B.BoxZoomTool({ dimensions: "width" });
        figure.add_tools(zoom);
        figure.toolbar.active_drag = zoom;
        paint(zoom.overlay, { fill_color: "--soft", line_color: "--soft" });
      }
      for (const axis of [...figure.xaxes, ...figure.yaxes]) {
        axis.major_label_text_font = "system-ui, sans-serif";
        axis.major_label_text_font_size = "11px";
        axis.minor_tick_line_color = null;
        axis.axis_line_color = null;
        paint(axis, { major_label_text_color: "--soft", major_tick_line_color: "--line" });
      }
      for (const grid of [...figure.xgrids, ...figure.ygrids])
        paint(grid, { grid_line_color: "--line" });
      paint(figure, { outline_line_color: "--line" });
      plots.push(figure);
      return figure;
    };

    const shade = (figure, members) => {
      for (const finding of facts.findings) {
        if (!finding.channels.some((i) => members.includes(i))) continue;
        const failed = finding.state === "failed";
        const box = new B.BoxAnnotation({
          left: finding.start, right: finding.end, level: "underlay", fill_alpha: 0.16,
          line_alpha: 0.8, line_width: 1, hatch_pattern: failed ? null : "right_diagonal_line",
          hatch_alpha: 0.25, hatch_scale: 8,
        });
        paint(box, { fill_color: "--tall", line_color: "--tall", hatch_color: "--tall" });
        figure.add_layout(box);
      }
    };

    const caption = (parent, words) => {
      const head = made("p", "caption");
      head.append(made("span", "what", words));
      parent.append(head);
      return head;
    };

    const ratePlot = (parent, group) => {
      const y_range = new B.Range1d({ start: -1, end: 1 });
      const figure = plot(RATE_HIGH, y_range);
      shade(figure, group.channels);
      const head = caption(parent, "Rate, deg/s");
      const shown = [];
      // A source has its colour everywhere, unless it has several channels here.
      const own = group.channels.map((i) => sources.indexOf(channels[i].source));
      const distinct = new Set(own).size === own.length;
      for (const [place, i] of group.channels.entries()) {
        const channel = channels[i], colour = `--source-${(distinct ? own[place] : place) % 6}`;
        const source = new B.ColumnDataSource({ data: zigzag(channel, (y) => y) });
        const glyph = figure.line({ field: "x" }, { field: "y" }, {
          source, line_width: channel.status === "failed" ? 1.8 : 1.2, line_join: "round",
          line_dash: channel.derived || (!distinct && place > 5) ? [4, 3] : [],
        });
        paint(glyph.glyph, { line_color: colour });
        const key = made("button", "key-button");
        key.type = "button";
        key.setAttribute("aria-pressed", "true");
        const mark = made("span", "mark");
        mark.style.background = `var(${colour})`;
        const value = made("span", "value");
        key.append(mark, made("span", "", channel.name), value);
        key.addEventListener("click", () => {
          glyph.visible = !glyph.visible;
          key.setAttribute("aria-pressed", String(glyph.visible));
          fit();
        });
        head.append(key);
        readers.push((time) => { value.textContent = time === null ? "" : range(channel, time); });
        shown.push([channel, glyph]);
      }
      const peaks = made("span", "cut");
      head.append(peaks);
      rates.push(() => {
        const lows = [], highs = [];
        for (const [line, glyph] of shown) {
          if (!glyph.visible || !line.t.length) continue;
          const stop = nearest(line.t, x_range.end);
          for (let i = nearest(line.t, x_range.start); i <= stop; i += 1) {
            if (line.low[i] <= line.high[i]) { lows.push(line.low[i]); highs.push(line.high[i]); }
          }
        }
        if (!lows.length) return;
        lows.sort((a, b) => a - b);
        highs.sort((a, b) => a - b);
        let least = lows[0], most = highs[highs.length - 1];
        // A few damaged readings must not flatten the flight; zoomed in, they are seen.
        const few = Math.floor(FEW * lows.length);
        const usual = highs[highs.length - 1 - few] - lows[few];
        const cut = few > 0 && usual > 0 && most - least > FLATTENED * usual;
        peaks.textContent = cut ? `peaks from ${number(least)} to ${number(most)} are cut off` : "";
        if (cut) { least = lows[few] - usual / 2; most = highs[highs.length - 1 - few] + usual / 2; }
        const room = 0.06 * (most - least) || 1;
        y_range.start = least - room;
        y_range.end = most + room;
      });
    };

    // One polygon for each stretch without a gap; with steps each value holds about its time.
    const outlines = ({ t, low, high }, hop) => {
      const xs = [], ys = [];
      for (let i = 0; i < t.length; i += 1) {
        if (Number.isNaN(low[i])) continue;
        const x = [], upper = [], lower = [];
        let reach = hop ? t[i] - hop / 2 : t[i];
        for (; i < t.length && !Number.isNaN(low[i]); i += 1) {
          const next = hop ? Math.min(t[i] + hop / 2, i + 1 < t.length ? (t[i] + t[i + 1]) / 2 : Infinity) : t[i];
          if (hop && t[i] - hop > reach + hop / 100) break;
          const top = placed(high[i]), bottom = placed(low[i]);
          if (hop) { x.push(reach); upper.push(top); lower.push(bottom); }
          x.push(next); upper.push(top); lower.push(bottom);
          reach = next;
        }
        if (hop && i < t.length && !Number.isNaN(low[i])) i -= 1;  // a gap in time: begin anew
        xs.push([...x, ...x.toReversed()]);
        ys.push([...upper, ...lower.toReversed()]);
      }
      return { xs, ys };
    };
    const band = (figure, edges, kind, alpha, hop) => {
      const source = new B.ColumnDataSource({ data: outlines(edges, hop) });
      const glyph = figure.patches({ field: "xs" }, { field: "ys" }, {
        source, fill_alpha: alpha, line_color: null,
      });
      paint(glyph.glyph, { fill_color: `--${kind}` });
    };
    const only = (edges, chosen) => {
      const kept = (values) => Float32Array.from(values, (value, i) => (chosen(i) ? value : NaN));
      return { t: edges.t, low: kept(edges.low), high: kept(edges.high) };
    };

    const residualPlot = (parent, panel) => {
      const line = lineOf(panel), names = panel.channels.map((i) => channels[i].name);
      const statistical = lineOf(panel.statistical), guaranteed = lineOf(panel.guaranteed);
      const figure = plot(RESIDUAL_HIGH, new B.Range1d({ start: -1, end: 1 }));
      shade(figure, panel.channels);
      const tolerated = placed(facts.tolerance);
      const allowed = new B.BoxAnnotation({
        bottom: -tolerated, top: tolerated, level: "underlay", fill_alpha: 0.7, line_width: 1,
        line_alpha: 0.7, line_dash: [6, 3],
      });
      paint(allowed, { fill_color: "--band", line_color: "--soft" });
      figure.add_layout(allowed);
      if (guaranteed) band(figure, guaranteed, "guaranteed", 0.3, 0);
      const source = new B.ColumnDataSource({ data: zigzag(line, placed) });
      const glyph = figure.line({ field: "x" }, { field: "y" }, { source, line_width: 1 });
      paint(glyph.glyph, { line_color: "--residual" });
      if (statistical) {
        const beyond = (i) => statistical.low[i] > facts.tolerance || statistical.high[i] < -facts.tolerance;
        band(figure, only(statistical, (i) => !beyond(i)), "statistical", 0.65, facts.hop);
        band(figure, only(statistical, beyond), "tall", 0.75, facts.hop);
      }
      for (const axis of figure.yaxes) {
        axis.ticker = new B.FixedTicker({ ticks: facts.ticks.map(([rate]) => placed(rate)) });
        axis.major_label_overrides = new Map(facts.ticks.map(([rate, label]) => [placed(rate), label]));
      }
      const head = caption(parent, names.length > 1
        ? `${names[0]} minus ${names[1]}, deg/s`
        : `${names[0]} minus what ${panel.against} predict${panel.peers === 1 ? "s" : ""}, deg/s`);
      const value = made("span", "value");
      head.append(value);
      readers.push((time) => {
        if (time === null) { value.textContent = ""; return; }
        const parts = [range(line, time)];
        if (statistical) parts.push(`interval ${range(statistical, time, facts.hop)}`);
        if (guaranteed) parts.push(`guaranteed ${range(guaranteed, time)}`);
        value.textContent = parts.join("; ");
      });
    };

    const places = [];
    const place = (parent, draws, ...rest) => {
      const box = made("div", "linked");
      parent.append(box);
      draws(box, ...rest);
      const canvas = made("div", "canvas");
      box.append(canvas);
      places.push(canvas);
      return box;
    };
    for (const group of facts.groups) {
      const part = made("div", "linked-group");
      part.append(made("h3", "", group.title));
      part.dataset.channels = group.channels.join(" ");
      stage.append(part);
      place(part, ratePlot, group);
      for (const panel of group.panels) place(part, residualPlot, panel);
      for (const above of plots.slice(plots.length - 1 - group.panels.length, -1)) {
        for (const axis of above.xaxes) axis.visible = false;  // the lowest speaks for all
        above.min_border_bottom = 3;
        above.height -= 17;
      }
    }

    // --- one time range for all -----------------------------------------------------------------
    const moment = document.getElementById("moment");
    const cursor = made("div", "cursor");
    cursor.hidden = true;
    stage.append(cursor);
    const [first, last] = facts.span;
    const look = (start, end) => {
      const span = Math.min(Math.max(end - start, LEAST_S), last - first);
      const begin = Math.min(Math.max(start, first), last - span);
      x_range.setv({ start: begin, end: begin + span });
    };
    const zoom = (factor, about) => {
      const { start, end } = x_range;
      const centre = about ?? (start + end) / 2;
      look(centre - (centre - start) * factor, centre + (end - centre) * factor);
    };
    const move = (share) => {
      const by = share * (x_range.end - x_range.start);
      look(x_range.start + by, x_range.end + by);
    };
    const seconds = (time) => {
      const places = Math.max(0, Math.min(4, 3 - Math.floor(Math.log10(x_range.end - x_range.start))));
      return time.toFixed(places);
    };
    const told = () => { moment.textContent = `${seconds(x_range.start)} s to ${seconds(x_range.end)} s`; };
    const fit = () => { for (const each of rates) each(); };
    let waiting = false;
    const changed = () => {
      if (waiting) return;
      waiting = true;
      requestAnimationFrame(() => { waiting = false; fit(); told(); point(null); });
    };
    x_range.properties.start.change.connect(changed);
    x_range.properties.end.change.connect(changed);

    const point = (time) => {
      for (const read of readers) read(time);
      cursor.hidden = time === null;
      if (time === null) return;
      const wide = stage.clientWidth - LEFT - RIGHT;
      cursor.style.left = `${LEFT + wide * (time - x_range.start) / (x_range.end - x_range.start)}px`;
      const utc = facts.utc === null ? "" : `, ${new Date(facts.utc + 1000 * time).toISOString().slice(11, 23)} UTC`;
      moment.textContent = `at ${seconds(time)} s${utc}`;
    };
    const timeAt = (event) => {
      const box = stage.getBoundingClientRect();
      const share = (event.clientX - box.left - LEFT) / (box.width - LEFT - RIGHT);
      return share < 0 || share > 1 ? null : x_range.start + share * (x_range.end - x_range.start);
    };
    stage.addEventListener("pointermove", (event) => { const t = timeAt(event); point(t); if (t === null) told(); });
    stage.addEventListener("pointerdown", (event) => point(timeAt(event)));
    stage.addEventListener("pointerleave", () => { point(null); told(); });
    stage.addEventListener("wheel", (event) => {
      if (!event.ctrlKey) return;  // a page that is scrolled must not zoom
      event.preventDefault();
      zoom(event.deltaY > 0 ? 1.25 : 0.8, timeAt(event) ?? undefined);
    }, { passive: false });
    stage.addEventListener("dblclick", () => look(first, last));

    const actions = {
      in: () => zoom(0.5), out: () => zoom(2), earlier: () => move(-0.25), later: () => move(0.25),
      whole: () => look(first, last),
    };
    const keys = { "+": "in", "=": "in", "-": "out", ArrowLeft: "earlier", ArrowRight: "later", 0: "whole" };
    stage.addEventListener("keydown", (event) => {
      if (!keys[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      actions[keys[event.key]]();
    });
    for (const button of document.querySelectorAll("[data-look]"))
      button.addEventListener("click", () => actions[button.dataset.look]());

    const showFinding = (finding) => {
      const room = Math.max(0.25 * (finding.end - finding.start), 0.002 * (last - first), LEAST_S);
      look(finding.start - room, finding.end + room);
    };
    for (const link of document.querySelectorAll("[data-finding]"))
      link.addEventListener("click", (event) => {
        const finding = facts.findings.find((each) => String(each.number) === link.dataset.finding);
        if (!finding) return;
        event.preventDefault();
        showFinding(finding);
        const part = [...stage.querySelectorAll(".linked-group")].find((each) =>
          each.dataset.channels.split(" ").some((i) => finding.channels.includes(Number(i))));
        (part ?? stage).scrollIntoView();
        stage.focus({ preventScroll: true });
      });

    repaint();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", repaint);
    fit();
    told();
    const page = new B.Document();
    for (const each of plots) page.add_root(each);
    document.documentElement.classList.add("drawn");  // a hidden place has no width to draw in
    B.embed.add_document_standalone(page, stage, places);
  }
})();
