// Many straight lines as one object of three.js, see common.py.
import { THREE } from "nicegui-scene";

export default class Segments {
  create_mesh(ends, colours) {
    this.mesh = new THREE.LineSegments(
      new THREE.BufferGeometry(),
      new THREE.LineBasicMaterial({ vertexColors: true }),
    );
    this.mesh.frustumCulled = false;
    this.set(ends, colours);
    return this.mesh;
  }
  set(ends, colours) {
    const shades = colours.flatMap((colour) => [colour, colour]).flatMap((colour) => new THREE.Color(colour).toArray());
    this.mesh.geometry.dispose();
    this.mesh.geometry = new THREE.BufferGeometry();
    this.mesh.geometry.setAttribute("position", new THREE.Float32BufferAttribute(ends.flat(), 3));
    this.mesh.geometry.setAttribute("color", new THREE.Float32BufferAttribute(shades, 3));
  }
}
