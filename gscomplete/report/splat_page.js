"use strict";
const page = JSON.parse(document.getElementById("data").textContent);
try {
  const view = new SplatView();
  document.body.append(view.canvas);
  view.load([page.splats], page.packing, page.azimuth_deg, page.elevation_deg);
  window.addEventListener("resize", () => view.draw());
  view.canvas.addEventListener("dblclick", () => { view.spin = !view.spin; view.draw(); });
} catch (error) {
  document.querySelector("p").textContent = String(error.message);
}
