"use strict";

const RADIANS_PER_PIXEL = 0.004;

/** Pulls the platform where the pointer grabs it, or turns it, and draws the spring or the moment. */
class Pull {
  /** `turns` of a pointer's event: whether it turns; `radius` [m] of the arrow of the moment. */
  constructor(view, platform, tell, turns, radius) {
    if (!view.renderer) return;
    Object.assign(this, { view, platform, plane: new THREE.Plane() });
    const canvas = view.renderer.domElement;
    this.material = new THREE.MeshBasicMaterial({ color: 0xd55e00 });
    this.rod = new THREE.Mesh(new THREE.CylinderGeometry(1, 1, 1, 12).rotateX(Math.PI / 2), this.material);
    this.arc = this.curvedArrow(radius);
    for (const shape of [this.rod, this.arc]) {
      shape.visible = false;
      view.world.add(shape);
    }
    // Before the camera's own, which would turn the view.
    canvas.addEventListener("pointerdown", (event) => {
      if (this.drag) return;
      const [hit] = view.ray(event).intersectObject(platform, true);
      if (!hit) return;
      event.stopImmediatePropagation();
      canvas.setPointerCapture(event.pointerId);
      view.controls.enabled = false;
      if (turns(event)) {
        // As a ball in the hand: sideways about the vertical of the picture, up and down about its horizontal.
        const [from, across, up] = [[event.clientX, event.clientY], new THREE.Vector3(), new THREE.Vector3()];
        view.camera.matrixWorld.extractBasis(across, up, new THREE.Vector3());
        this.drag = ({ clientX, clientY }) => {
          const [right, down] = [clientX - from[0], clientY - from[1]].map((way) => RADIANS_PER_PIXEL * way);
          const turn = up.clone().multiplyScalar(right).addScaledVector(across, down);
          tell({ do: "turn", turn: turn.toArray() });
        };
      } else {
        // The hand moves in a plane through what it grabbed, across the line of sight.
        const point = platform.worldToLocal(hit.point.clone()).toArray();
        this.plane.setFromNormalAndCoplanarPoint(view.camera.getWorldDirection(new THREE.Vector3()), hit.point);
        this.drag = (moved) => {
          const place = view.ray(moved).ray.intersectPlane(this.plane, new THREE.Vector3());
          if (place) tell({ do: "pull", point, place: place.toArray() });
        };
      }
      this.drag(event);
    }, true);
    let due = 0;
    canvas.addEventListener("pointermove", (event) => {
      if (!this.drag || performance.now() < due) return;
      due = performance.now() + 30; // [ms] between two commands
      this.drag(event);
    });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => {
      if (!this.drag) return;
      this.drag = null;
      view.controls.enabled = true;
      tell({ do: "release" });
    });
    // The right button turns; a menu would take the pointer away.
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  }

  /** Three quarters of a circle about z, with a head where it ends. */
  curvedArrow(radius) {
    const [arrow, pieces, whole] = [new THREE.Group(), 36, 1.5 * Math.PI];
    const piece = new THREE.CylinderGeometry(0.03 * radius, 0.03 * radius, 1.2 * whole * radius / pieces, 8);
    const head = new THREE.CylinderGeometry(0, 0.12 * radius, 0.3 * radius, 16);
    for (let k = 0; k <= pieces; k += 1) {
      const [mesh, angle] = [new THREE.Mesh(k < pieces ? piece : head, this.material), k / pieces * whole];
      mesh.position.set(radius * Math.cos(angle), radius * Math.sin(angle), 0);
      mesh.rotation.z = angle;
      arrow.add(mesh);
    }
    return arrow;
  }

  /** The spring and the moment, as a row tells them. */
  show({ pull, moment }) {
    if (!this.rod) return;
    this.rod.visible = Boolean(pull);
    if (pull) {
      const [from, to] = [new THREE.Vector3(...pull.at), new THREE.Vector3(...pull.place)];
      const thick = 0.006 * this.view.camera.position.distanceTo(from);
      this.rod.position.copy(from).add(to).multiplyScalar(0.5);
      this.rod.lookAt(to);
      this.rod.scale.set(thick, thick, Math.max(1e-6, from.distanceTo(to)));
    }
    const axis = new THREE.Vector3(...(moment ?? [0, 0, 0]));
    this.arc.visible = axis.length() > 0;
    if (this.arc.visible) {
      this.arc.position.copy(this.platform.position);
      this.arc.quaternion.setFromUnitVectors(new THREE.Vector3(0, 0, 1), axis.normalize());
    }
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
    for (const group of ["Machine", "Gains", "Model"]) document.getElementById(`knobs-${group}`).replaceChildren();
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
