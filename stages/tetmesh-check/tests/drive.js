// Uses the page as a reader does, and sends what it found to the window that holds it.
"use strict";
(async () => {
  const pick = id => document.getElementById(id), view = pick("view"), found = {};
  const frame = () => new Promise(done => setTimeout(() => requestAnimationFrame(() => requestAnimationFrame(done)), 60));
  while (!view.dataset.state) await frame();
  found.state = view.dataset.state;
  found.console = [];
  const camera = () => view.dataset.camera.split(" ").map(Number);
  const set = async (id, value) => {
    const element = pick(id); if (element.type === "checkbox") element.checked = value; else element.value = value;
    element.dispatchEvent(new Event("input")); element.dispatchEvent(new Event("change")); await frame();
  };
  const wheel = async more => {
    const event = new WheelEvent("wheel", { deltaY: -100, bubbles: true, cancelable: true, ...more });
    view.dispatchEvent(event); await frame(); return event.defaultPrevented;
  };
  const key = async (name, more) => { view.dispatchEvent(new KeyboardEvent("keydown", { key: name, bubbles: true, cancelable: true, ...more })); await frame(); };
  const point = async (type, x, y, more) => {
    const box = view.getBoundingClientRect();
    view.dispatchEvent(new PointerEvent(type, { clientX: box.left + x * box.width, clientY: box.top + y * box.height, pointerId: 1, pointerType: "mouse", bubbles: true, ...more }));
    await frame();
  };
  view.setPointerCapture = () => {};  // of pointers that are not there
  view.dataset.measure = "1";
  const covered = async () => { pick("view-edges").dispatchEvent(new Event("change")); await frame(); return +view.dataset.covered; };

  found.start = camera();
  found.plainWheel = [await wheel({}), camera()[2]];
  found.ctrlWheel = [await wheel({ ctrlKey: true }), camera()[2]];
  await key("0"); view.focus();
  found.wheelInside = [await wheel({}), camera()[2]];
  await key("Escape");
  found.wheelAfterEscape = [await wheel({}), document.activeElement === view];
  await key("0"); await key("ArrowLeft"); found.left = camera();
  await key("ArrowUp", { shiftKey: true }); found.shifted = camera();
  await key("+"); found.plus = camera()[2];
  pick("view-reset").click(); await frame(); found.reset = camera();
  await point("pointerdown", 0.5, 0.5); await point("pointermove", 0.6, 0.5, { buttons: 1 }); await point("pointerup", 0.6, 0.5);
  found.dragged = camera();
  await point("pointerdown", 0.5, 0.5, { pointerType: "touch" }); await point("pointermove", 0.6, 0.5, { pointerType: "touch" });
  found.touched = camera(); await key("0");
  const finger = (id, x, y) => { const box = view.getBoundingClientRect(); return new Touch({ identifier: id, target: view, clientX: box.left + x, clientY: box.top + y }); };
  const touch = async (type, ...fingers) => {
    const event = new TouchEvent(type, { touches: fingers, bubbles: true, cancelable: true });
    view.dispatchEvent(event); await frame(); return event.defaultPrevented;
  };
  found.oneFinger = [await touch("touchstart", finger(0, 100, 100)), await touch("touchmove", finger(0, 100, 160)), ...camera()];
  await touch("touchstart", finger(0, 100, 100), finger(1, 200, 100));
  found.twoFingers = [await touch("touchmove", finger(0, 100, 100), finger(1, 300, 100)), ...camera()];
  await touch("touchend"); await key("0");
  found.touchAction = getComputedStyle(view).touchAction;

  found.covered = await covered();
  await set("view-clip", "2"); await set("view-depth", "0"); found.clipped = await covered();
  await set("view-clip", "view"); await set("view-depth", "100"); found.clippedAway = await covered();
  await set("view-clip", ""); found.unclipped = await covered();

  await point("pointermove", 0.5, 0.5); found.value = pick("view-value").textContent;
  await point("pointermove", 0.02, 0.02); found.nothing = pick("view-value").textContent;
  await set("view-colour", "2"); found.bar = [pick("view-bar").hidden, pick("view-bar").textContent];
  await set("view-worst", true); found.worst = pick("view-bar").textContent; await set("view-worst", false);
  await set("view-mesh", "2"); found.within = [await covered(), pick("view-colour").selectedOptions[0].textContent];
  await set("view-mesh", "0");
  found.ruler = [pick("view-ruler").textContent, parseFloat(pick("view-ruler").querySelector("i").style.width), view.clientHeight];
  const letters = () => [...pick("view-cube").querySelectorAll("g")].filter(g => g.style.display !== "none").map(g => g.textContent);
  found.letters = letters();
  [...pick("view-cube").querySelectorAll("g")].find(g => g.textContent === "L").dispatchEvent(new Event("click")); await frame();
  found.lookedFromLeft = [letters(), ...camera()];

  const figure = document.querySelector("figure.slices"), slider = figure.querySelector("input"), path = figure.querySelector(".over");
  const before = [figure.querySelector(".window").getAttribute("viewBox"), path.getAttribute("d")];
  slider.value = +slider.value + 3; slider.dispatchEvent(new Event("input"));
  const after = [figure.querySelector(".window").getAttribute("viewBox"), path.getAttribute("d")];
  found.slices = [before[0] !== after[0], before[1] !== after[1] && after[1].length > 50, figure.querySelector("output").textContent];
  await set("outlines", false); found.hidden = getComputedStyle(document.querySelector(".outlines")).display;
  found.wide = [document.documentElement.scrollWidth, window.innerWidth];
  found.paper = getComputedStyle(document.body).backgroundColor;
  found.state = view.dataset.state;
  parent.postMessage(JSON.stringify(found), "*");
})().catch(error => parent.postMessage(JSON.stringify({ error: String(error) }), "*"));
