"use strict";

const TRAIL = 75; // dots behind the ball
const CLICK = 4; // [pixel] that the pointer may move within a click

/** Holds the ball where the pointer is, lets it go with the pointer's velocity, and puts its target where one clicks. */
class BallHand {
  /** `ball` as `about` tells it; to be made before `Pull`, which takes what is not the ball. */
  constructor(view, ball, tell) {
    if (!view.renderer) return;
    const [platform, body] = ["platform", "ball"].map((name) => view.links.find((link) => link.name === name));
    const canvas = view.renderer.domElement;
    Object.assign(this, { view, ball, platform });
    const dot = new THREE.SphereGeometry(0.12 * ball.radius, 6, 4), material = new THREE.MeshBasicMaterial({ color: 0xd55e00 });
    this.trail = Array.from({ length: TRAIL }, () => new THREE.Mesh(dot, material));
    for (const each of this.trail) {
      each.visible = false;
      platform.add(each);
    }
    let dragged = false, due = 0, from = null;
    const hold = (event) => {
      const place = this.place(event, ball.radius);
      if (place) tell({ do: "hold", place });
    };
    canvas.addEventListener("pointerdown", (event) => {
      const ray = view.ray(event);
      from = event.button === 0 && ray.intersectObject(platform, true).length ? [event.clientX, event.clientY] : null;
      if (event.button !== 0 || !ray.intersectObject(body, true).length) return;
      event.stopImmediatePropagation();
      canvas.setPointerCapture(event.pointerId);
      view.controls.enabled = false;
      [dragged, from] = [true, null];
      hold(event);
    }, true);
    canvas.addEventListener("pointermove", (event) => {
      if (!dragged || performance.now() < due) return;
      due = performance.now() + 30; // [ms] between two commands
      hold(event);
    });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => {
      if (dragged) {
        dragged = false;
        view.controls.enabled = true;
        tell({ do: "let_go" });
      } else if (from && ball.balanced && Math.hypot(event.clientX - from[0], event.clientY - from[1]) < CLICK) {
        const place = this.place(event, 0);
        if (place && Math.hypot(...place) < ball.plate) tell({ do: "ball_target", place });
      }
      from = null;
    });
    const button = (id, command) => document.getElementById(id).addEventListener("click", () => tell(command()));
    button("ball-throw", () => {
      const [low, high] = ball.throw, angle = 2 * Math.PI * Math.random(), speed = low + (high - low) * Math.random();
      return { do: "throw", velocity: [speed * Math.cos(angle), speed * Math.sin(angle)] };
    });
    button("ball-centre", () => ({ do: "ball_target", place: [0, 0] }));
    button("ball-path", () => ({ do: "ball_target", place: null }));
    for (const id of ["ball-centre", "ball-path"]) document.getElementById(id).disabled = !ball.balanced;
  }

  /** x, y [m] in the platform's frame of what the pointer shows at a height [m] over the plate; null beside it. */
  place(event, height) {
    const normal = new THREE.Vector3(0, 0, 1).applyQuaternion(this.platform.quaternion);
    const origin = this.platform.localToWorld(new THREE.Vector3(0, 0, this.ball.height + height));
    const plane = new THREE.Plane().setFromNormalAndCoplanarPoint(normal, origin);
    const at = this.view.ray(event).ray.intersectPlane(plane, new THREE.Vector3());
    return at && this.platform.worldToLocal(at).toArray().slice(0, 2);
  }

  /** The trace behind the ball, as a row tells its place. */
  show({ ball, paused }) {
    if (!this.trail || paused) return;
    if (!ball) return this.trail.forEach((dot) => { dot.visible = false; });
    const dot = this.trail.shift();
    dot.position.set(...ball.place, this.ball.height + 0.05 * this.ball.radius);
    dot.visible = true;
    this.trail.push(dot);
  }
}
