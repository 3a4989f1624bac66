// The slices of the volume: a slider moves the window over the sheet that holds all slices of a plane, and changes the outline. Pointing at
// a label tells its name, which its colour in the sheet determines.
"use strict";
(async () => {
  const data = document.getElementById("slices-data");
  if (!data || !("DecompressionStream" in window)) return;
  const packed = Uint8Array.from(atob(data.textContent), c => c.charCodeAt(0));
  const { planes, names } = await new Response(new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"))).json();
  const reader = new OffscreenCanvas(1, 1).getContext("2d", { willReadFrequently: true });
  for (const figure of document.querySelectorAll("figure.slices")) {
    const plane = planes[+figure.dataset.plane], slider = figure.querySelector("input"), [w, h] = plane.size;
    const show = () => {
      const n = +slider.value, x = (n % plane.columns) * w, y = Math.floor(n / plane.columns) * h;
      figure.querySelector(".window").setAttribute("viewBox", `${x} ${y} ${w} ${h}`);
      for (const path of figure.querySelectorAll("path")) path.setAttribute("d", plane.paths[n]);
      figure.querySelector("output").textContent = `slice ${plane.slices[n] + 1}`;
      figure.dataset.shown = n;
    };
    const sheet = new Image(), slice = figure.querySelector(".slice");
    sheet.src = figure.querySelector("image").href.baseVal;
    const read = event => {
      const n = +slider.value, at = new DOMPoint(event.clientX, event.clientY).matrixTransform(slice.getScreenCTM().inverse());
      const [x, y] = [Math.floor(at.x), Math.floor(at.y)];
      if (!sheet.complete || x < 0 || y < 0 || x >= w || y >= h) return show();
      reader.drawImage(sheet, (n % plane.columns) * w + x, Math.floor(n / plane.columns) * h + y, 1, 1, 0, 0, 1, 1);
      const name = names[reader.getImageData(0, 0, 1, 1).data.slice(0, 3).join()];
      figure.querySelector("output").textContent = `slice ${plane.slices[n] + 1}${name ? `: ${name}` : ""}`;
    };
    if (Object.keys(names).length) for (const kind of ["pointermove", "pointerdown"]) slice.addEventListener(kind, read);
    slider.addEventListener("input", show);
    show();
  }
  const toggle = document.getElementById("outlines");
  if (toggle) toggle.addEventListener("change", () => {
    for (const group of document.querySelectorAll(".outlines")) group.style.display = toggle.checked ? "" : "none";
  });
})();
