// The slices of the volume: a slider moves the window over the sheet that holds all slices of a plane, and changes the outline.
"use strict";
(async () => {
  const data = document.getElementById("slices-data");
  if (!data || !("DecompressionStream" in window)) return;
  const packed = Uint8Array.from(atob(data.textContent), c => c.charCodeAt(0));
  const planes = await new Response(new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"))).json();
  for (const figure of document.querySelectorAll("figure.slices")) {
    const plane = planes[+figure.dataset.plane], slider = figure.querySelector("input"), [w, h] = plane.size;
    const show = () => {
      const n = +slider.value, x = (n % plane.columns) * w, y = Math.floor(n / plane.columns) * h;
      figure.querySelector(".window").setAttribute("viewBox", `${x} ${y} ${w} ${h}`);
      for (const path of figure.querySelectorAll("path")) path.setAttribute("d", plane.paths[n]);
      figure.querySelector("output").textContent = `slice ${plane.slices[n] + 1}`;
      figure.dataset.shown = n;
    };
    slider.addEventListener("input", show);
    show();
  }
  const toggle = document.getElementById("outlines");
  if (toggle) toggle.addEventListener("change", () => {
    for (const group of document.querySelectorAll(".outlines")) group.style.display = toggle.checked ? "" : "none";
  });
})();
