// Many bodies of one shape as one object of three.js, see common.py.
import { THREE } from "nicegui-scene";

const SHAPES = { box: THREE.BoxGeometry, sphere: THREE.SphereGeometry, cylinder: THREE.CylinderGeometry };

export default class Bodies {
  create_mesh(shape, sizes, opacity, count, places, colours) {
    // Of what is seen through, the inner sides alone, unlit; nobody hides who is behind.
    const material =
      opacity < 1
        ? new THREE.MeshBasicMaterial({ transparent: true, opacity, side: THREE.BackSide, depthWrite: false })
        : new THREE.MeshLambertMaterial();
    this.mesh = new THREE.InstancedMesh(new SHAPES[shape](...sizes), material, count);
    this.mesh.frustumCulled = false;
    this.set(places, colours);
    return this.mesh;
  }
  set(places, colours) {
    this.mesh.count = places.length;
    places.forEach((place, row) => this.mesh.setMatrixAt(row, new THREE.Matrix4().set(...place, 0, 0, 0, 1)));
    this.mesh.instanceMatrix.needsUpdate = true;
    if (!colours?.length) return; // as before, or of nobody
    colours.forEach((colour, row) => this.mesh.setColorAt(row, new THREE.Color(colour)));
    this.mesh.instanceColor.needsUpdate = true;
  }
}
