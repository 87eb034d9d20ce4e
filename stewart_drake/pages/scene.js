"use strict";

/** A robot drawn from shapes that are told once, whose links then go where they are put; see `runs/scene.py`. */
class RobotScene {
  constructor(box, { camera, target, lens, fixed, links }) {
    this.world = new THREE.Scene();
    this.links = Object.entries(links).map(([name, shapes]) => this.link(name, shapes));
    this.link("fixed", fixed);
    this.world.add(new THREE.HemisphereLight(0xffffff, 0x8a93a0, 2.2));
    const distance = new THREE.Vector3(...camera).distanceTo(new THREE.Vector3(...target));
    this.camera = new THREE.PerspectiveCamera(lens, 1, 0.01 * distance, 100 * distance);
    this.camera.up.set(0, 0, 1);
    this.camera.position.set(...camera);
    // The light stands beside the camera, so that no side of the robot is dark.
    const lamp = new THREE.DirectionalLight(0xffffff, 1.8);
    lamp.position.set(-0.6, 1, 1);
    this.camera.add(lamp);
    this.world.add(this.camera);
    try {
      this.renderer = new THREE.WebGLRenderer({ antialias: true, alpha: true });
    } catch {
      box.textContent = "The picture of the robot needs WebGL, which this browser lacks or has switched off.";
      return;
    }
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    box.append(this.renderer.domElement);
    this.controls = new THREE.OrbitControls(this.camera, this.renderer.domElement);
    this.controls.target.set(...target);
    this.controls.update();
    this.controls.addEventListener("change", () => this.draw());
    new ResizeObserver(() => this.fit(box.clientWidth, box.clientHeight)).observe(box);
    this.box = box;
  }

  /** A named group of shapes in the world. */
  link(name, shapes) {
    const group = new THREE.Group();
    group.name = name;
    for (const { kind, size, at, colour } of shapes) {
      const [red, green, blue, opacity] = colour;
      const material = new THREE.MeshStandardMaterial({ roughness: 0.55, opacity, transparent: opacity < 1, depthWrite: opacity === 1 });
      material.color.setRGB(red, green, blue, THREE.SRGBColorSpace);
      const mesh = new THREE.Mesh(RobotScene.SHAPES[kind](size), material);
      mesh.position.set(...at.slice(0, 3));
      mesh.rotation.set(...at.slice(3), "ZYX");
      group.add(mesh);
    }
    this.world.add(group);
    return group;
  }

  /** Puts the links where seven numbers each say, position [m] and quaternion x, y, z, w; or a share of the way on. */
  place(now, next = now, share = 0) {
    const [from, to] = [new THREE.Quaternion(), new THREE.Quaternion()];
    this.links.forEach((link, k) => {
      const { position, quaternion } = link;
      // A ghost is there only while its places are told.
      link.visible = now.length >= 7 * (k + 1);
      if (!link.visible) return;
      const [a, b] = [now, next].map((values) => values.slice(7 * k, 7 * k + 7));
      position.set(...[0, 1, 2].map((axis) => a[axis] + share * (b[axis] - a[axis])));
      quaternion.slerpQuaternions(from.fromArray(a, 3), to.fromArray(b, 3), share);
    });
    this.draw();
  }

  /** Paints links, by name, in the colour of a fault, and puts a label beside the last of them; none paints all as they were. */
  mark(names, label = null) {
    const marked = this.links.filter(({ name }) => names.includes(name));
    for (const link of this.links) for (const { material, userData } of link.children) {
      userData.colour ??= material.color.clone();
      if (marked.includes(link)) material.color.set(0xd00020); else material.color.copy(userData.colour);
    }
    [this.marked, this.label] = [marked.at(-1), label];
    this.draw();
  }

  /** Puts the label where the middle of the marked link is in the picture. */
  placeLabel() {
    const to = this.marked.getWorldPosition(new THREE.Vector3()).project(this.camera);
    this.label.style.left = `${Math.round((to.x + 1) / 2 * this.box.clientWidth + 14)}px`;
    this.label.style.top = `${Math.round((1 - to.y) / 2 * this.box.clientHeight - 12)}px`;
  }

  /** A ray from the camera through a pointer's event. */
  ray({ clientX, clientY }) {
    const { left, top, width, height } = this.renderer.domElement.getBoundingClientRect();
    const ray = new THREE.Raycaster();
    ray.setFromCamera(new THREE.Vector2(2 * (clientX - left) / width - 1, 1 - 2 * (clientY - top) / height), this.camera);
    return ray;
  }

  fit(width, height) {
    if (!width || !height) return;
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.renderer.setSize(width, height);
    this.draw();
  }

  /** Once before the browser's next picture, however often it is asked for. */
  draw() {
    if (this.asked || !this.renderer) return;
    this.asked = requestAnimationFrame(() => {
      this.asked = 0;
      this.renderer.render(this.world, this.camera);
      if (this.label && this.marked) this.placeLabel();
    });
  }
}

RobotScene.SHAPES = {
  box: ([x, y, z]) => new THREE.BoxGeometry(x, y, z),
  cylinder: ([radius, length]) => new THREE.CylinderGeometry(radius, radius, length, 64).rotateX(Math.PI / 2),
  sphere: ([radius]) => new THREE.SphereGeometry(radius, 32, 16),
  ellipsoid: ([x, y, z]) => new THREE.SphereGeometry(1, 32, 16).scale(x, y, z),
};
