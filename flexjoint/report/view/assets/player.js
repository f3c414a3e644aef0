// Shows a scene (scene.py packs it) in MeshCat's viewer and plays it. `window.flexjoint` is its handle.
"use strict";
(function () {
  const THREE = MeshCat.THREE;
  const byId = (id) => document.getElementById(id);
  const KINDS = { f4: Float32Array, u2: Uint16Array, u4: Uint32Array };
  const COLD = [0.13, 0.34, 0.75], MIDDLE = [0.93, 0.93, 0.9], HOT = [0.82, 0.1, 0.13];

  function bounds(points) {
    const axes = [0, 1, 2].map((k) => points.map((p) => p[k]));
    return { low: axes.map((v) => Math.min(...v)), high: axes.map((v) => Math.max(...v)) };
  }

  async function unpacked() {
    const text = atob(byId("scene").textContent.trim());
    const zipped = Uint8Array.from(text, (c) => c.charCodeAt(0));
    const stream = new Blob([zipped]).stream().pipeThrough(new DecompressionStream("gzip"));
    const whole = await new Response(stream).arrayBuffer();
    const length = new DataView(whole).getUint32(0, true);
    const scene = JSON.parse(new TextDecoder().decode(new Uint8Array(whole, 4, length)));
    Object.assign(scene, bounds(scene.extent));
    const numbers = (place) => new KINDS[place[0]](whole, 4 + length + place[1], place[2]);
    const track = (place) => place && { rows: place[3], width: place[2] / place[3], data: numbers(place) };
    return { scene, numbers, track };
  }

  function colour(share) {
    const s = Math.max(-1, Math.min(1, share)), end = s < 0 ? COLD : HOT, a = Math.abs(s);
    return MIDDLE.map((m, k) => m + a * (end[k] - m));
  }

  function geometryOf(mesh, numbers) {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(numbers(mesh.vertices), 3));
    geometry.setIndex(new THREE.BufferAttribute(numbers(mesh.triangles), 1));
    return geometry;
  }

  function materialOf(part) {
    const clear = part.opacity < 1;
    const material = new THREE.MeshPhongMaterial({
      color: new THREE.Color(...part.colour), side: THREE.DoubleSide, flatShading: !part.overlay,
      specular: 0x222222, shininess: 25, transparent: clear || part.overlay, opacity: part.opacity,
      depthTest: !part.overlay, depthWrite: !clear && !part.overlay,
      // where the motor side and the robot coincide, the robot is seen
      polygonOffset: clear, polygonOffsetFactor: 2, polygonOffsetUnits: 8,
    });
    return material;
  }

  function lights(viewer, scene) {
    for (const name of ["SpotLight", "PointLightNegativeX", "PointLightPositiveX", "FillLight"])
      viewer.set_property(["Lights", name], "visible", false);
    viewer.set_property(["Lights", "AmbientLight"], "intensity", 0.62);
    const low = new THREE.Vector3(...scene.low), high = new THREE.Vector3(...scene.high);
    const middle = low.clone().add(high).multiplyScalar(0.5), reach = 0.75 * high.distanceTo(low) + 0.2;
    const key = new THREE.DirectionalLight(0xffffff, 0.7), back = new THREE.DirectionalLight(0xffffff, 0.4);
    key.position.copy(middle).add(new THREE.Vector3(0.7, -0.9, 1.9).multiplyScalar(2 * reach));
    back.position.copy(middle).add(new THREE.Vector3(-1.0, 0.8, 0.6).multiplyScalar(2 * reach));
    key.castShadow = true;
    key.shadow.mapSize.set(2048, 2048);
    Object.assign(key.shadow.camera, { left: -reach, right: reach, top: reach, bottom: -reach, near: 0.1, far: 8 * reach });
    key.shadow.bias = -0.002;
    for (const [name, light] of [["Key", key], ["Back", back]]) {
      light.target.position.copy(middle);
      viewer.set_object(["Lights", name], light);
      viewer.set_object(["Lights", `${name} target`], light.target);
    }
  }

  function ground(viewer, scene) {
    const width = scene.high[0] - scene.low[0], depth = scene.high[1] - scene.low[1];
    const side = 2 * Math.ceil(0.5 * (Math.max(width, depth) + 2 * Math.min(Math.max(width, depth), 2) + 1));
    const floor = new THREE.Mesh(new THREE.PlaneGeometry(side, side), new THREE.ShadowMaterial({ opacity: 0.22 }));
    floor.receiveShadow = true;
    const lines = new THREE.GridHelper(side, 2 * side, 0x9aa5b1, 0xc9d0d8); // 0.5 m
    lines.rotateX(Math.PI / 2);
    const both = new THREE.Group();
    both.add(floor, lines);
    both.position.set(Math.round(scene.low[0] + 0.5 * width), Math.round(scene.low[1] + 0.5 * depth), scene.ground);
    lines.position.z = -0.001;
    viewer.set_property(["Grid"], "visible", false);
    viewer.set_property(["Axes"], "visible", false);
    viewer.set_object(["flexjoint", "ground"], both);
    viewer.set_property(["Background"], "top_color", [0.86, 0.9, 0.95]);
    viewer.set_property(["Background"], "bottom_color", [0.97, 0.98, 0.99]);
  }

  // MeshCat's scene is turned: where three.js looks from, y is up.
  const turned = (p) => new THREE.Vector3(p[0], p[2], -p[1]);

  function aim(viewer, scene) {
    const camera = viewer.camera, corners = scene.extent.map(turned);
    const away = turned(scene.direction).normalize();
    const right = new THREE.Vector3(0, 1, 0).cross(away).normalize(), up = away.clone().cross(right);
    const w = window.innerWidth, h = window.innerHeight, several = scene.actors.length > 1;
    // a long lens shows several robots from one side
    Object.assign(camera, { fov: several ? 9 : 28, near: 0.02, far: 500, aspect: w / h });
    // one robot stands beside the panel, several below it and their labels; all above the bar
    const left = several ? 0 : Math.min(byId("head").offsetWidth, 0.3 * w);
    const top = several ? Math.min(byId("head").offsetHeight + 30, 0.5 * h) : 0;
    const bottom = byId("player").offsetHeight + 12;
    const tall = Math.tan((camera.fov * Math.PI) / 360) * ((h - top - bottom) / h);
    const wide = Math.tan((camera.fov * Math.PI) / 360) * ((w - left) / h);
    camera.setViewOffset(w, h, -0.5 * left, 0.5 * (bottom - top), w, h);
    const target = new THREE.Vector3();
    let distance = 0;
    for (let round = 0; round < 4; round++) { // what perspective makes of the middle moves it a little
      const seen = corners.map((c) => {
        const d = c.clone().sub(target), depth = distance ? distance - d.dot(away) : 1;
        return [d.dot(right) / depth, d.dot(up) / depth];
      });
      for (const [axis, k] of [[right, 0], [up, 1]]) {
        const values = seen.map((s) => s[k]), middle = 0.5 * (Math.min(...values) + Math.max(...values));
        target.addScaledVector(axis, middle * (distance || 1));
      }
      distance = 0.3;
      for (const corner of corners) { // 0.86: room for what moves beyond the links, and some air
        const d = corner.clone().sub(target);
        distance = Math.max(distance, Math.abs(d.dot(up)) / (0.86 * tall) + d.dot(away),
          Math.abs(d.dot(right)) / (0.86 * wide) + d.dot(away));
      }
    }
    camera.position.copy(target).addScaledVector(away, distance);
    camera.updateProjectionMatrix();
    viewer.controls.target.copy(target);
    viewer.controls.update();
    viewer.set_dirty();
  }

  class Player {
    constructor(data) {
      Object.assign(this, data);
      this.viewer = new MeshCat.Viewer(byId("pane"));
      this.times = this.numbers(this.scene.times);
      this.frame = -1;
      this.playing = false;
      this.layers = {};
      lights(this.viewer, this.scene);
      ground(this.viewer, this.scene);
      this.build();
      this.panel();
      this.show(0);
      this.viewer.set_3d_pane_size();
      aim(this.viewer, this.scene);
      const hover = (event) => this.point(event.clientX, event.clientY, event.buttons > 0);
      byId("pane").addEventListener("pointermove", hover);
      let touched = false;
      this.viewer.controls.addEventListener("start", () => { touched = true; });
      window.addEventListener("resize", () => { if (!touched) aim(this.viewer, this.scene); });
    }

    build() {
      const geometries = this.scene.meshes.map((mesh) => geometryOf(mesh, this.numbers));
      for (const geometry of geometries) geometry.computeVertexNormals();
      this.nodes = this.scene.nodes.map((node) => {
        const group = new THREE.Group();
        for (const part of node.parts) {
          const mesh = new THREE.Mesh(geometries[part.mesh], materialOf(part));
          new THREE.Matrix4().fromArray(part.matrix).decompose(mesh.position, mesh.quaternion, mesh.scale);
          mesh.castShadow = part.opacity === 1 && !part.overlay;
          mesh.receiveShadow = mesh.castShadow;
          mesh.renderOrder = part.overlay ? 2 : part.opacity < 1 ? 1 : 0;
          group.add(mesh);
        }
        const path = ["flexjoint", this.scene.actors[node.actor].label.replace(/\//g, " ") + " " + node.actor, node.layer, node.name];
        this.viewer.set_object(path, group);
        const own = { group, layer: node.layer, name: node.name, place: this.scene.actors[node.actor].place,
          poses: this.track(node.poses), scales: this.track(node.scales), values: this.track(node.values) };
        (this.layers[node.layer] = this.layers[node.layer] || []).push(group);
        return own;
      });
      this.hung = this.scene.actors.length > 1 ? this.scene.actors.map((actor) => {
        const label = document.createElement("div");
        label.textContent = actor.label;
        byId("labels").append(label);
        return { label, at: turned(actor.label_at) };
      }) : [];
    }

    panel() {
      document.querySelector("#head h1").textContent =
        this.scene.actors.length > 1 ? this.scene.title : this.scene.actors[0].label;
      for (const layer of this.scene.layers) {
        const row = document.createElement("label"), box = document.createElement("input");
        box.type = "checkbox";
        box.checked = layer.visible;
        box.onchange = () => this.toggle(layer.name, box.checked);
        row.append(box);
        if (layer.colour) {
          const dot = document.createElement("span");
          dot.className = "dot";
          dot.style.background = layer.colour;
          row.append(dot);
        }
        row.append(layer.label);
        byId("layers").append(row);
        this.toggle(layer.name, layer.visible);
      }
      if (this.scene.legend) this.legend(this.scene.legend);
      byId("notes").textContent = this.scene.notes.join("; ");
      const last = this.times.length - 1, slider = byId("slider");
      byId("player").classList.toggle("still", last < 1);
      slider.max = last;
      slider.oninput = () => { this.pause(); this.show(Number(slider.value)); };
      byId("play").onclick = () => (this.playing ? this.pause() : this.play());
      window.addEventListener("keydown", (event) => {
        if (event.code === "Space" && last > 0) { event.preventDefault(); byId("play").onclick(); }
      });
    }

    legend(legend) {
      const canvas = document.createElement("canvas"), ends = document.createElement("div");
      canvas.width = 201;
      canvas.height = 1;
      const pen = canvas.getContext("2d");
      for (let k = 0; k < 201; k++) {
        pen.fillStyle = `rgb(${colour(k / 100 - 1).map((c) => Math.round(255 * c)).join(",")})`;
        pen.fillRect(k, 0, 1, 1);
      }
      const limit = Number(legend.limit.toPrecision(3));
      ends.className = "ends";
      for (const text of [`-${limit}`, `${legend.label} [${legend.unit}]`, `+${limit}`]) {
        const span = document.createElement("span");
        span.textContent = text;
        ends.append(span);
      }
      byId("legend").append(canvas, ends);
    }

    // Which joint is that? The name and value of the spring under the mouse.
    point(x, y, held) {
      const tip = byId("tip"), ray = new THREE.Raycaster(), w = window.innerWidth, h = window.innerHeight;
      ray.setFromCamera(new THREE.Vector2((2 * x) / w - 1, 1 - (2 * y) / h), this.viewer.camera);
      const springs = this.nodes.filter((node) => node.values && node.group.visible);
      const [hit] = held ? [] : ray.intersectObjects(springs.map((node) => node.group), true);
      tip.style.display = hit ? "block" : "none";
      if (!hit) return;
      const { values, name } = springs.find((node) => node.group === hit.object.parent);
      const value = values.data[values.rows > 1 ? this.frame : 0];
      tip.textContent = `${name.replace("spring/", "")}: ${value.toPrecision(3)} ${this.scene.legend.unit}`;
      tip.style.left = `${Math.max(4, Math.min(x + 14, w - tip.offsetWidth - 4))}px`;
      tip.style.top = `${Math.max(4, Math.min(y + 14, h - tip.offsetHeight - 4))}px`;
    }

    toggle(layer, visible) {
      for (const group of this.layers[layer] || []) group.visible = visible;
      this.viewer.set_dirty();
    }

    show(frame) {
      frame = Math.max(0, Math.min(this.times.length - 1, frame));
      if (frame === this.frame) return;
      this.frame = frame;
      const row = (track) => track && (track.rows > 1 ? frame : 0) * track.width;
      for (const node of this.nodes) {
        const p = node.poses.data, k = row(node.poses), s = node.scales;
        node.group.position.set(p[k] + node.place[0], p[k + 1] + node.place[1], p[k + 2] + node.place[2]);
        node.group.quaternion.set(p[k + 3], p[k + 4], p[k + 5], p[k + 6]);
        if (s) node.group.scale.fromArray(s.data, row(s));
        if (node.values) {
          const rgb = colour(node.values.data[row(node.values)] / this.scene.legend.limit);
          for (const mesh of node.group.children) mesh.material.color.setRGB(...rgb);
        }
      }
      byId("slider").value = frame;
      const whole = this.times[this.times.length - 1];
      byId("clock").textContent = `${this.times[frame].toFixed(2)} / ${whole.toFixed(2)} s`;
      this.viewer.set_dirty();
    }

    seek(time) {
      let frame = 0;
      while (frame < this.times.length - 1 && this.times[frame + 1] <= time + 1e-6) frame++;
      this.show(frame);
    }

    play() {
      if (this.frame >= this.times.length - 1) this.show(0);
      this.playing = true;
      this.from = { clock: performance.now(), time: this.times[this.frame] };
      byId("play").textContent = "\u275A\u275A";
    }

    pause() {
      this.playing = false;
      byId("play").textContent = "\u25B6";
    }

    labels() {
      const camera = this.viewer.camera;
      const places = this.hung.map(({ at }) => at.clone().project(camera));
      const across = places.map((p) => (0.5 + 0.5 * p.x) * window.innerWidth);
      const gap = Math.min(...across.slice(1).map((x, k) => Math.abs(x - across[k])));
      this.hung.forEach(({ label }, k) => {
        label.style.maxWidth = `${Math.max(gap - 24, 40)}px`; // their paddings, and a little between them
        label.style.left = `${across[k]}px`;
        label.style.top = `${(0.5 - 0.5 * places[k].y) * window.innerHeight}px`;
      });
    }

    tick() {
      if (this.playing) {
        const speed = Number(byId("speed").value);
        const time = this.from.time + (1e-3 * (performance.now() - this.from.clock)) * speed;
        this.seek(time);
        if (this.frame >= this.times.length - 1) this.pause();
      }
      this.labels();
    }

    draw() { // now, for a picture
      this.viewer.render();
      this.labels();
    }
  }

  function said(error) {
    byId("head").querySelector("h1").textContent = `The scene cannot be shown: ${error.message || error}`;
    window.flexjointFailed = String(error.message || error);
    console.error(error);
  }

  async function start() {
    const player = new Player(await unpacked());
    const wanted = new URLSearchParams(location.hash.slice(1));
    document.body.classList.toggle("plain", wanted.has("plain"));
    if (wanted.has("t")) player.seek(Number(wanted.get("t")));
    else if (player.times.length > 1) player.play();
    const loop = () => { requestAnimationFrame(loop); player.tick(); };
    loop();
    window.flexjoint = player;
    player.draw();
  }
  start().catch(said);
})();
