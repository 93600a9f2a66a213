"use strict";
(() => {
  const data = JSON.parse(document.getElementById("cs-data").textContent);
  const find = (selector, root = document) => root.querySelector(selector);
  const all = (selector, root = document) => [...root.querySelectorAll(selector)];
  const stage = find(".stage"), cams = all(".cam"), over = find(".over"), drawing = find(".drawing");
  const divider = find(".divider"), words = find(".status .words"), chip = find(".status .chip");
  const SVG = "http://www.w3.org/2000/svg";
  const made = (name, attributes, parent) => {
    const element = document.createElementNS(SVG, name);
    for (const key in attributes) element.setAttribute(key, attributes[key]);
    return parent.appendChild(element);
  };

  // ---- the camera: one view box for the picture, the drawing and what lies over them
  const camera = { x: 0, y: 0, scale: 1 };
  let fitted = true;
  const MOST = 512;
  const pane = () => {
    const box = cams[0].getBoundingClientRect();
    return { width: Math.max(1, box.width), height: Math.max(1, box.height), left: box.left, top: box.top };
  };
  const least = (box) => Math.min(box.width / data.width, box.height / data.height);
  function fit() {
    const box = pane();
    camera.scale = least(box) * (box.width > 500 ? 0.96 : 1);
    camera.x = data.width / 2 - box.width / camera.scale / 2;
    camera.y = data.height / 2 - box.height / camera.scale / 2;
    fitted = true;
    show();
  }
  function show() {
    const box = pane();
    const view = [camera.x, camera.y, box.width / camera.scale, box.height / camera.scale].join(" ");
    for (const cam of cams) cam.setAttribute("viewBox", view);
    find("#cs-checker").setAttribute("patternTransform", `scale(${1 / camera.scale})`);
    const pixels = camera.scale * (window.devicePixelRatio || 1);
    stage.classList.toggle("close", pixels >= 2);
    stage.dataset.zoom = camera.scale.toPrecision(6);
    find(".scale").textContent = camera.scale < 10 ? `${+camera.scale.toPrecision(2)}×` : `${Math.round(camera.scale)}×`;
  }
  function zoom(factor, clientX, clientY) {
    const box = pane();
    const px = clientX === undefined ? box.width / 2 : (clientX - box.left) % box.width;
    const py = clientY === undefined ? box.height / 2 : clientY - box.top;
    const before = camera.scale;
    camera.scale = Math.min(MOST, Math.max(least(box) / 4, before * factor));
    camera.x += px / before - px / camera.scale;
    camera.y += py / before - py / camera.scale;
    fitted = false;
    show();
  }
  function move(dx, dy) {
    camera.x -= dx / camera.scale;
    camera.y -= dy / camera.scale;
    fitted = false;
    show();
  }
  new ResizeObserver(() => (fitted ? fit() : show())).observe(stage);
  stage.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0018)), event.clientX, event.clientY);
  }, { passive: false });
  stage.addEventListener("dblclick", (event) => zoom(2.5, event.clientX, event.clientY));

  // ---- pointers: one drags, two pinch, a still one points at a curve
  const pointers = new Map();
  let apart = 0;
  stage.addEventListener("pointerdown", (event) => {
    if (event.target.closest(".divider")) return;
    stage.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, event);
    apart = 0;
    stage.classList.add("dragging");
  });
  stage.addEventListener("pointermove", (event) => {
    if (!pointers.has(event.pointerId)) return point(event);
    const last = pointers.get(event.pointerId);
    pointers.set(event.pointerId, event);
    const [first, second] = [...pointers.values()];
    if (!second) return move(event.clientX - last.clientX, event.clientY - last.clientY);
    const now = Math.hypot(first.clientX - second.clientX, first.clientY - second.clientY);
    if (apart) zoom(now / apart, (first.clientX + second.clientX) / 2, (first.clientY + second.clientY) / 2);
    apart = now;
  });
  for (const kind of ["pointerup", "pointercancel"])
    stage.addEventListener(kind, (event) => {
      pointers.delete(event.pointerId);
      apart = 0;
      stage.classList.toggle("dragging", pointers.size > 0);
      if (kind === "pointerup") point(event);
    });

  // ---- the slider
  function split(percent) {
    const value = Math.min(100, Math.max(0, percent));
    stage.style.setProperty("--split", `${value}%`);
    divider.setAttribute("aria-valuenow", Math.round(value));
  }
  divider.addEventListener("pointerdown", (event) => {
    divider.setPointerCapture(event.pointerId);
    divider.focus({ preventScroll: true });
    event.preventDefault();
  });
  divider.addEventListener("pointermove", (event) => {
    if (!divider.hasPointerCapture(event.pointerId)) return;
    const box = stage.getBoundingClientRect();
    split((100 * (event.clientX - box.left)) / box.width);
  });
  divider.addEventListener("keydown", (event) => {
    const now = +divider.getAttribute("aria-valuenow");
    const to = { ArrowLeft: now - 2, ArrowRight: now + 2, Home: 0, End: 100, PageDown: now - 20, PageUp: now + 20 }[event.key];
    if (to === undefined) return;
    event.preventDefault();
    event.stopPropagation();
    split(to);
  });

  // ---- curves
  const elements = data.kind ? all("path, circle, ellipse, rect:not(#background)", drawing) : [];
  const numbers = new Map(elements.map((element, index) => [element, index]));
  let stack = [], chosen = -1;
  let waiting = null;
  function point(event) {
    if (!elements.length) return;
    const first = waiting === null;
    waiting = [event.clientX, event.clientY];
    if (first) requestAnimationFrame(() => {
      const [x, y] = waiting;
      waiting = null;
      stack = document.elementsFromPoint(x, y).map((e) => numbers.get(e)).filter((index) => index !== undefined);
      choose(stack.length ? stack[0] : -1);
    });
  }
  function choose(index) {
    chosen = index;
    for (const old of all(".mark", over)) old.remove();
    chip.style.display = index < 0 ? "none" : "block";
    if (index < 0) return void (words.textContent = data.kind ? `Point at a ${data.kind} to see it alone.` : "");
    const element = elements[index];
    const group = made("g", { class: "mark" }, over);
    const transform = placed(element, group);
    for (const name of ["halo", "edge"]) copied(element, transform, name);
    if (element.tagName === "path") handles(element.getAttribute("d"), transform);
    describe(element, index);
  }
  // A group in which the element's own coordinates hold.
  function placed(element, parent) {
    const outer = element.parentNode.getAttribute && element.parentNode.getAttribute("transform");
    return made("g", outer && element.parentNode.tagName === "g" ? { transform: outer } : {}, parent);
  }
  function copied(element, parent, name) {
    const copy = parent.appendChild(element.cloneNode());
    for (const gone of ["id", "fill", "fill-opacity", "stroke", "stroke-opacity", "stroke-width", "stroke-linecap", "stroke-linejoin"])
      copy.removeAttribute(gone);
    copy.setAttribute("class", name);
    return copy;
  }
  // Anchors and handles of path data; of a crowd of them there would be nothing to see.
  function handles(d, parent) {
    const found = points(d);
    if (found.anchors.length > 400) return;
    const dots = (list) => list.map((p) => `M${p[0]} ${p[1]}h0`).join("");
    made("path", { class: "handle", d: found.arms.map((a) => `M${a[0]} ${a[1]}L${a[2]} ${a[3]}`).join("") }, parent);
    made("path", { class: "control back", d: dots(found.controls) }, parent);
    made("path", { class: "control", d: dots(found.controls) }, parent);
    made("path", { class: "anchor", d: dots(found.anchors) }, parent);
  }
  function points(d) {
    const anchors = [], controls = [], arms = [];
    let x = 0, y = 0, sx = 0, sy = 0, cx = 0, cy = 0, pieces = 0;
    const counts = { M: 2, L: 2, H: 1, V: 1, C: 6, S: 4, Q: 4, T: 2, A: 7, Z: 0 };
    for (const [, letter, rest] of d.matchAll(/([a-zA-Z])([^a-zA-Z]*)/g)) {
      const upper = letter.toUpperCase(), relative = letter !== upper, count = counts[upper];
      const values = (rest.match(/-?(?:\d+\.?\d*|\.\d+)/g) || []).map(Number);
      if (upper === "Z") { if (x !== sx || y !== sy) pieces++; [x, y] = [sx, sy]; continue; }
      for (let at = 0; at + count <= values.length; at += count) {
        const v = values.slice(at, at + count), [bx, by] = relative ? [x, y] : [0, 0];
        const [x0, y0] = [x, y];
        if (upper === "H") x = v[0] + bx;
        else if (upper === "V") y = v[0] + by;
        else [x, y] = [v[count - 2] + bx, v[count - 1] + by];
        if (upper === "M" && at === 0) [sx, sy] = [x, y];
        else pieces++;
        if (upper === "C" || upper === "S") {
          const first = upper === "C" ? [v[0] + bx, v[1] + by] : [2 * x0 - cx, 2 * y0 - cy];
          [cx, cy] = [v[count - 4] + bx, v[count - 3] + by];
          controls.push(first, [cx, cy]);
          arms.push([x0, y0, ...first], [x, y, cx, cy]);
        } else [cx, cy] = [x, y];
        anchors.push([x, y]);
      }
    }
    return { anchors, controls, arms, pieces };
  }
  function describe(element, index) {
    const stroked = !element.hasAttribute("fill");
    const paint = element.getAttribute(stroked ? "stroke" : "fill");
    const opacity = +getComputedStyle(element)[stroked ? "strokeOpacity" : "fillOpacity"];
    chip.style.background = paint;
    const box = element.getBBox(), drawn = find("svg", drawing);
    const unit = Math.abs(element.getScreenCTM().a / drawn.getScreenCTM().a) || 1;
    const size = (length) => (length * (element.tagName === "path" ? unit : 1)).toFixed(length * unit < 10 ? 1 : 0);
    const worth = data.losses[index], parts = [];
    const name = element.id && element.id !== "" ? element.id : `${data.kind} ${elements.length - index}`;
    parts.push(`${name}${element.id ? `, ${data.kind} ${elements.length - index}` : ""} of ${elements.length} from the front`);
    parts.push(`${paint}${opacity < 1 ? ` at ${Math.round(100 * opacity)} %` : ""}`);
    parts.push(`${size(box.width)} × ${size(box.height)} px`);
    if (element.tagName === "path") {
      const pieces = points(element.getAttribute("d")).pieces;
      parts.push(`${pieces} ${pieces === 1 ? "segment" : "segments"}`);
    } else parts.push(element.tagName);
    if (worth !== undefined) parts.push(`without it ${worth > 0 ? "−" : "+"}${Math.abs(worth).toFixed(Math.abs(worth) < 0.1 ? 4 : 2)} dB`);
    if (stack.length > 1) parts.push(`${stack.indexOf(index) + 1} of ${stack.length} here`);
    words.textContent = parts.join(" · ");
  }
  function through(step) {
    if (stack.length > 1) choose(stack[(stack.indexOf(chosen) + step + stack.length) % stack.length]);
  }
  function next(step) {
    if (!elements.length) return;
    stack = [];
    choose(chosen < 0 ? elements.length - 1 : (chosen - step + elements.length) % elements.length);
  }

  // ---- views
  function view(name) {
    const input = find(`input[value=${name}]`);
    if (!input) return;
    input.checked = true;
    stage.dataset.view = name;
    if (name === "error") measured().catch((error) => (words.textContent = `This browser cannot compute the error: ${error.message}`));
    const lines = find(".outlines", over);
    if (name !== "outlines") lines && lines.remove();
    else if (!lines) outline();
    fitted ? fit() : show();
  }
  function outline() {
    const group = made("g", { class: "outlines" }, over);
    over.prepend(group);
    let parent = null, last = null;
    for (const element of elements) {
      if (element.parentNode !== last) parent = placed(element, group);
      last = element.parentNode;
      copied(element, parent, "outline");
    }
  }
  for (const input of all(".views input")) input.addEventListener("change", () => view(input.value));

  // ---- the error, as this browser draws both
  const STOPS = [[0, 0, 4], [66, 10, 104], [147, 38, 103], [221, 81, 58], [252, 165, 10], [252, 255, 164]];
  let once = null;
  const measured = () => (once = once || error());
  async function loaded(url) {
    const image = new Image();
    image.src = url;
    await image.decode();
    return image;
  }
  function drawnUrl() {
    const image = find("image", drawing);
    if (image) return image.getAttribute("href");
    const text = new XMLSerializer().serializeToString(find("svg", drawing));
    return `data:image/svg+xml;charset=utf-8,${encodeURIComponent(text)}`;
  }
  async function error() {
    const shrink = Math.min(1, Math.sqrt(16e6 / (data.width * data.height)));
    const width = Math.max(1, Math.round(data.width * shrink)), height = Math.max(1, Math.round(data.height * shrink));
    const images = await Promise.all([loaded(find(".original").getAttribute("href")), loaded(drawnUrl())]);
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [width, height];
    const context = canvas.getContext("2d", { willReadFrequently: true });
    const over = (image, ground) => {
      context.fillStyle = ground;
      context.fillRect(0, 0, width, height);
      context.drawImage(image, 0, 0, width, height);
      return context.getImageData(0, 0, width, height).data;
    };
    const pairs = ["#000", "#fff"].map((ground) => images.map((image) => over(image, ground)));
    const result = context.createImageData(width, height);
    const squares = [0, 0];
    for (let at = 0; at < result.data.length; at += 4) {
      let most = 0;
      pairs.forEach(([a, b], ground) => {
        for (let c = at; c < at + 3; c++) {
          const difference = Math.abs(a[c] - b[c]);
          squares[ground] += difference * difference;
          if (difference > most) most = difference;
        }
      });
      const along = Math.min(4.999, (most / 64) * 5), index = Math.floor(along), part = along - index;
      for (let c = 0; c < 3; c++)
        result.data[at + c] = STOPS[index][c] * (1 - part) + STOPS[index + 1][c] * part;
      result.data[at + 3] = 255;
    }
    context.putImageData(result, 0, 0);
    const blob = await new Promise((done) => canvas.toBlob(done));
    find(".error").setAttribute("href", URL.createObjectURL(blob));
    const mean = Math.max(...squares) / (width * height * 3);
    const level = mean ? `${(10 * Math.log10(65025 / mean)).toFixed(2)} dB` : "no difference";
    words.textContent = `As this browser draws it: ${level}.`;
    stage.dataset.browserDb = level;
  }

  // ---- buttons and keys
  const actions = { in: () => zoom(1.6), out: () => zoom(1 / 1.6), fit, copy };
  async function copy(event) {
    const code = find(".command code");
    try {
      await navigator.clipboard.writeText(code.textContent);
      event.target.textContent = "Copied";
    } catch {
      getSelection().selectAllChildren(code); // no clipboard on this page: it is selected for Ctrl-C
      event.target.textContent = "Selected";
    }
  }
  for (const button of all("[data-do]")) button.addEventListener("click", (event) => actions[button.dataset.do](event));
  const STEP = 60;
  const keys = {
    "+": () => zoom(1.6), "=": () => zoom(1.6), "-": () => zoom(1 / 1.6), 0: fit,
    n: () => next(1), p: () => next(-1), "]": () => through(1), "[": () => through(-1), Escape: () => choose(-1),
    1: () => view("compare"), 2: () => view("beside"), 3: () => view("error"), 4: () => view("outlines"),
  };
  const arrows = { ArrowLeft: [STEP, 0], ArrowRight: [-STEP, 0], ArrowUp: [0, STEP], ArrowDown: [0, -STEP] };
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (arrows[event.key] && document.activeElement === stage) move(...arrows[event.key]);
    else if (keys[event.key]) keys[event.key]();
    else return;
    event.preventDefault();
  });
  fit();
})();
