  // Before and after: #stage holds both pictures and the divider, #slider is its range input.
  const at = id => document.getElementById(id);
  function makeSlider(pointed) {
    const stage = at("stage"), slider = at("slider");
    function slide() {
      stage.style.setProperty("--at", slider.value + "%");
      slider.setAttribute("aria-valuetext", Math.round(slider.value) + "% " + at("before").alt);
    }
    function point(event) {
      const box = stage.getBoundingClientRect();
      const x = (event.clientX - box.left) / box.width, y = (event.clientY - box.top) / box.height;
      pointed(x, y);
      if (event.buttons & 1 || event.type === "pointerdown") {
        slider.value = Math.min(Math.max(x, 0), 1) * 100;
        slide();
      }
    }
    stage.addEventListener("pointerdown", event => { stage.setPointerCapture(event.pointerId); point(event); });
    stage.addEventListener("pointermove", point);
    slider.addEventListener("input", slide);
    slide();
  }
