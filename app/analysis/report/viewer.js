"use strict";
// Draws the data in #report-data: whole figures, time plots from packed channels, and the chosen grasp.
(() => {
  const NO_VALUE = 65535;
  const data = JSON.parse(document.getElementById("report-data").textContent);
  const options = { displaylogo: false, responsive: true };

  /** Unpack little-endian 16-bit steps between the minimum and the maximum. */
  function unpack([text, low, high], logarithmic) {
    const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    const steps = new DataView(bytes.buffer);
    const scale = (high - low) / (NO_VALUE - 1);
    return Array.from({ length: bytes.length / 2 }, (_, i) => {
      const step = steps.getUint16(2 * i, true);
      if (step === NO_VALUE) return null;
      return logarithmic ? 10 ** (low + step * scale) : low + step * scale;
    });
  }

  function drawCourse(box, course) {
    const { data: lines, layout } = structuredClone(data.course);
    const filled = lines.map((line, i) => {
      const y = unpack(course.channels[i], data.logarithmic[i]);
      return { ...line, y, x: y.map((_, at) => course.begin_s + at * course.step_s) };
    });
    const points = filled[0].x;
    for (const [name, axis] of Object.entries(layout)) {
      if (name.startsWith("xaxis")) axis.range = [points.at(0), points.at(-1)];
    }
    return Plotly.react(box, [...filled, ...course.marks], layout, options);
  }

  const draw = (box) => {
    if (box.dataset.course) return drawCourse(box, data.courses[Number(box.dataset.course)]);
    const { data: lines, layout } = structuredClone(data.figures[box.dataset.figure]);
    return Plotly.react(box, lines, layout, options);
  };

  // Draw one plot after the other, so that the page stays usable; printing draws all the rest at once.
  const waiting = [...document.querySelectorAll("[data-course], [data-figure]")];
  function drawNext() {
    const box = waiting.shift();
    if (!box) return void (document.documentElement.dataset.drawn = "true");
    draw(box);
    setTimeout(drawNext);
  }
  addEventListener("beforeprint", () => {
    for (const box of waiting.splice(0)) draw(box);
  });

  const buttons = [...document.querySelectorAll("button[data-grasp]")];
  const title = document.getElementById("grasp-title");
  let chosen = -1;

  function showGrasp(index) {
    if (!data.grasps[index]) return;
    buttons[chosen]?.removeAttribute("aria-current");
    buttons[chosen]?.closest("tr").classList.remove("chosen");
    chosen = index;
    buttons[chosen]?.setAttribute("aria-current", "true");
    buttons[chosen]?.closest("tr").classList.add("chosen");
    const grasp = data.grasps[index];
    title.textContent = grasp.title;
    drawCourse(document.getElementById("grasp-course"), grasp.course);
    const { data: lines, layout } = structuredClone(data.figures.references);
    const own = { x: grasp.strain, mode: "lines", line: { color: "#000000", width: 2.5 } };
    const measured = { ...own, y: grasp.measured_kpa, name: "measured" };
    const estimated = { ...own, y: grasp.estimated_kpa, name: "estimated", line: { ...own.line, width: 1.5, dash: "dash" } };
    Plotly.react(document.getElementById("grasp-stress"), [...lines, ...(grasp.strain ? [measured, estimated] : [])], layout, options);
    document.getElementById("grasp-before").disabled = index === 0;
    document.getElementById("grasp-after").disabled = index === data.grasps.length - 1;
  }

  for (const button of buttons) {
    button.addEventListener("click", () => {
      showGrasp(Number(button.dataset.grasp));
      document.getElementById("grasp").scrollIntoView();
    });
  }
  if (data.grasps.length) {
    document.getElementById("grasp-before").addEventListener("click", () => showGrasp(chosen - 1));
    document.getElementById("grasp-after").addEventListener("click", () => showGrasp(chosen + 1));
    showGrasp(0);
  }
  drawNext();
})();
