"use strict";
// Buttons that sort the photos, and the slider between a photo and what the model makes of it.
(() => {
  const press = (buttons, pressed) => {
    for (const button of buttons) button.setAttribute("aria-pressed", button === pressed ? "true" : "false");
  };

  for (const bar of document.querySelectorAll("[data-sort]")) {
    const list = document.getElementById(bar.dataset.sort);
    const buttons = [...bar.querySelectorAll("button")];
    for (const button of buttons) {
      button.addEventListener("click", () => {
        const key = button.dataset.key;
        const value = (item) => item.dataset[key];
        // Worst first; photos without a value at the end.
        const compare = (a, b) => {
          if (key === "name") return value(a).localeCompare(value(b), undefined, { numeric: true });
          if (value(a) === "" || value(b) === "") return (value(a) === "") - (value(b) === "");
          const rising = key === "keypoints";
          return (rising ? 1 : -1) * (Number(value(a)) - Number(value(b)));
        };
        list.append(...[...list.children].sort(compare));
        press(buttons, button);
      });
    }
  }

  const compare = document.getElementById("compare");
  if (compare) {
    const images = [...compare.querySelectorAll(".stage img")];
    const rows = [...compare.querySelectorAll("button[data-row]")];
    const panels = [...compare.querySelectorAll("button[data-panel]")];
    const stage = compare.querySelector(".stage");
    const slider = compare.querySelector("input");
    let row = "0";
    let panel = "1";
    const show = () => {
      for (const image of images) {
        image.hidden = image.dataset.row !== row || (image.dataset.panel !== "0" && image.dataset.panel !== panel);
      }
      press(rows, rows.find((button) => button.dataset.row === row));
      press(panels, panels.find((button) => button.dataset.panel === panel));
    };
    for (const button of rows) button.addEventListener("click", () => { row = button.dataset.row; show(); });
    for (const button of panels) button.addEventListener("click", () => { panel = button.dataset.panel; show(); });
    const cut = (share) => stage.style.setProperty("--cut", `${share}%`);
    slider.addEventListener("input", () => cut(slider.value));
    stage.addEventListener("pointermove", (event) => {
      if (event.target === slider || (event.pointerType !== "mouse" && event.buttons === 0)) return;
      const box = stage.getBoundingClientRect();
      slider.value = (100 * (event.clientX - box.left)) / box.width;
      cut(slider.value);
    });
    show();
  }
})();
