"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const config = { responsive: true, displaylogo: false, modeBarButtonsToRemove: ["toImage"] };
  const narrow = () => window.innerWidth < 600;
  // The second frame begins when the first one is on the screen.
  const painted = () => new Promise((done) =>
    requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done))));
  const draw = {};

  // Names, markers and lines in space take as long as all solids: the robot is seen before them.
  for (const [name, { data: traces, layout }] of Object.entries(data.figures)) {
    draw[name] = async (place, atOnce) => {
      const settings = { ...config, displayModeBar: name === "robot" && !narrow() };
      const later = atOnce ? [] : traces.flatMap(({ type, visible }, i) =>
        type === "scatter3d" && visible === undefined ? [i] : []);
      const first = traces.map((trace, i) =>
        later.includes(i) ? { ...trace, visible: "legendonly" } : trace);
      await Plotly.newPlot(place, first, layout, settings);
      if (later.length === 0) return;
      await painted();
      await Plotly.restyle(place, { visible: true }, later);
    };
  }

  const numbers = (packed) => {
    const bytes = Uint8Array.from(atob(packed), (c) => c.charCodeAt(0));
    const view = new DataView(bytes.buffer);
    return Float32Array.from({ length: bytes.length / 4 }, (_, i) => view.getFloat32(4 * i, true));
  };
  const colours = ["#0072b2", "#d55e00", "#009e73"];
  const axes = ["x", "y", "z"];

  draw.traces = (place) => {
    const trace = data.traces[document.getElementById("su").value];
    const time = numbers(trace.time);
    const lines = [];
    axes.forEach((axis, a) => {
      const reading = numbers(trace.reading[a]);
      const predicted = numbers(trace.predicted[a]);
      const left = reading.map((value, i) => 1000 * (value - predicted[i]));
      const line = (more) => ({ x: time, mode: "lines", type: "scatter", ...more });
      lines.push(
        line({ y: reading, name: `${axis} read`, line: { color: colours[a], width: 3 }, opacity: 0.45 }),
        line({ y: predicted, name: `${axis} predicted`, line: { color: colours[a], width: 1 } }),
        line({ y: left, name: `${axis} left`, yaxis: "y2", line: { color: colours[a], width: 1 }, showlegend: false }),
      );
    });
    const font = data.figures.by_su.layout.font;
    const grid = "#e4e7eb";
    const layout = {
      font, height: 560, paper_bgcolor: "#fff", plot_bgcolor: "#fff",
      margin: { l: 60, r: 10, t: 10, b: 40 },
      legend: { orientation: "h", x: 0, y: 1.02, yanchor: "bottom" },
      xaxis: { title: { text: "time [s]" }, gridcolor: grid, anchor: "y2" },
      yaxis: { title: { text: "specific force [m/s²]" }, gridcolor: grid, domain: [0.36, 1] },
      yaxis2: { title: { text: "left [mm/s²]" }, gridcolor: grid, domain: [0, 0.3] },
    };
    return Plotly.react(place, lines, layout, { ...config, displayModeBar: !narrow() });
  };

  const choice = document.getElementById("su");
  if (choice) {
    const logs = new Set(data.traces.map((trace) => trace.log));
    data.traces.forEach((trace, i) => {
      const log = logs.size > 1 ? `, log ${trace.log + 1}` : "";
      const left = Number((1000 * trace.rms).toPrecision(2));
      choice.add(new Option(`${trace.su}${log}: ${left} mm/s² left`, String(i)));
    });
    choice.addEventListener("change", () => draw.traces(document.getElementById("traces")));
  }

  // What is out of sight is drawn when it comes near, and one thing is seen before the next is
  // drawn, so that the page opens at once.
  const drawn = new Set();
  const show = (place, atOnce) => {
    if (drawn.has(place.id)) return undefined;
    drawn.add(place.id);
    return draw[place.id](place, atOnce);
  };
  const places = document.querySelectorAll(".plot");
  let before = Promise.resolve();
  const watch = new IntersectionObserver(
    (seen) => {
      for (const { target } of seen.filter((s) => s.isIntersecting)) {
        before = before.then(() => show(target, false)).then(painted);
      }
    },
    { rootMargin: "400px" },
  );
  places.forEach((place) => watch.observe(place));
  window.addEventListener("beforeprint", () => places.forEach((place) => show(place, true)));
})();
