"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const config = { responsive: true, displaylogo: false, modeBarButtonsToRemove: ["toImage"] };
  const narrow = () => window.innerWidth < 600;
  const draw = {};

  for (const [name, figure] of Object.entries(data.figures)) {
    draw[name] = (place) => {
      const settings = { ...config, displayModeBar: name === "robot" && !narrow() };
      return Plotly.newPlot(place, figure.data, figure.layout, settings);
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

  // What is out of sight is drawn when it comes near, so that the page opens at once.
  const drawn = new Set();
  const show = (place) => {
    if (drawn.has(place.id)) return;
    drawn.add(place.id);
    draw[place.id](place);
  };
  const places = document.querySelectorAll(".plot");
  const watch = new IntersectionObserver(
    (seen) => seen.filter((s) => s.isIntersecting).forEach((s) => show(s.target)),
    { rootMargin: "400px" },
  );
  places.forEach((place) => watch.observe(place));
  window.addEventListener("beforeprint", () => places.forEach(show));
})();
