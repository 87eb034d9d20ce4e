"use strict";

/** Pulls the platform where the pointer grabs it, and draws the spring. */
class Pull {
  constructor(view, platform, tell) {
    if (!view.renderer) return;
    this.view = view;
    this.ray = new THREE.Raycaster();
    this.plane = new THREE.Plane();
    const canvas = view.renderer.domElement;
    const material = new THREE.MeshBasicMaterial({ color: 0xd55e00 });
    this.rod = new THREE.Mesh(new THREE.CylinderGeometry(1, 1, 1, 12).rotateX(Math.PI / 2), material);
    this.rod.visible = false;
    view.world.add(this.rod);
    const aim = (event) => {
      const { left, top, width, height } = canvas.getBoundingClientRect();
      const at = new THREE.Vector2(2 * (event.clientX - left) / width - 1, 1 - 2 * (event.clientY - top) / height);
      this.ray.setFromCamera(at, view.camera);
    };
    // Before the camera's own, which would turn the view.
    canvas.addEventListener("pointerdown", (event) => {
      aim(event);
      const [hit] = this.ray.intersectObject(platform, true);
      if (!hit) return;
      event.stopImmediatePropagation();
      canvas.setPointerCapture(event.pointerId);
      view.controls.enabled = false;
      this.point = platform.worldToLocal(hit.point.clone()).toArray();
      // The hand moves in a plane through what it grabbed, across the line of sight.
      this.plane.setFromNormalAndCoplanarPoint(view.camera.getWorldDirection(new THREE.Vector3()), hit.point);
      tell({ do: "pull", point: this.point, place: hit.point.toArray() });
    }, true);
    let due = 0;
    canvas.addEventListener("pointermove", (event) => {
      if (!this.point || performance.now() < due) return;
      due = performance.now() + 30; // [ms] between two commands
      aim(event);
      const place = this.ray.ray.intersectPlane(this.plane, new THREE.Vector3());
      if (place) tell({ do: "pull", point: this.point, place: place.toArray() });
    });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => {
      if (!this.point) return;
      this.point = null;
      view.controls.enabled = true;
      tell({ do: "release" });
    });
  }

  /** The spring, as a row tells it. */
  show(pull) {
    if (!this.rod) return;
    this.rod.visible = Boolean(pull);
    if (!pull) return;
    const [from, to] = [new THREE.Vector3(...pull.at), new THREE.Vector3(...pull.place)];
    const thick = 0.006 * this.view.camera.position.distanceTo(from);
    this.rod.position.copy(from).add(to).multiplyScalar(0.5);
    this.rod.lookAt(to);
    this.rod.scale.set(thick, thick, Math.max(1e-6, from.distanceTo(to)));
  }
}

/** Sliders of keys, as rows list them; made anew where the list changes. */
class Knobs {
  constructor(tell, hold) {
    this.tell = tell;
    this.hold = hold;
    this.shown = "";
    this.inputs = new Map();
  }

  show(knobs, held) {
    const list = knobs.map(({ key, low, high }) => `${key} ${low} ${high}`).join();
    if (list !== this.shown) this.make(knobs);
    this.shown = list;
    for (const knob of knobs) {
      const { input, write } = this.inputs.get(knob.key);
      if (input === held) continue;
      input.value = knob.logarithmic ? Math.log10(Math.max(knob.value, knob.low)) : knob.value;
      write();
    }
  }

  make(knobs) {
    this.inputs.clear();
    for (const group of ["Machine", "Gains", "Belief"]) document.getElementById(`knobs-${group}`).replaceChildren();
    for (const { group, key, label, unit, low, high, logarithmic, whole } of knobs) {
      const line = document.createElement("label");
      line.className = "slider";
      line.title = key;
      line.append(`${label} `);
      const [input, output] = [document.createElement("input"), document.createElement("output")];
      const scale = logarithmic ? Math.log10 : (value) => value;
      Object.assign(input, { type: "range", min: scale(low), max: scale(high), step: whole ? 1 : "any", id: `knob-${key}` });
      const value = () => (logarithmic ? 10 ** Number(input.value) : Number(input.value));
      const write = () => {
        const number = value() < 1e5 ? String(Number(value().toPrecision(2))) : value().toExponential(1);
        output.textContent = `${number} ${unit === "-" ? "" : unit}`;
      };
      line.append(input, output);
      document.getElementById(`knobs-${group}`).append(line);
      this.hold(input, write, () => this.tell({ do: "knob", key, value: value() }));
      this.inputs.set(key, { input, write });
    }
    if (!knobs.some(({ group }) => group === "Gains")) {
      const note = document.createElement("p");
      note.className = "hint";
      note.textContent = "No gains to set: a tuner chooses them. Another controller has some.";
      document.getElementById("knobs-Gains").append(note);
    }
  }
}
