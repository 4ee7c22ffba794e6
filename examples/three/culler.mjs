// Hides the meshes of a three.js scene that are not visible from the cell of the camera.
//
//   const culler = new SightlineCuller(Pvs.parse(bytes), gltf.scene);
//   culler.update(camera.position);            // each frame, before renderer.render
//
// GLTFLoader must load the scene from the file that was baked. The class assigns meshes to objects of the
// result by their order, which GLTFLoader keeps (nodes depth first, primitives in order), and checks the
// numbers of triangles. The class hides meshes by their layers, because `visible = false` would also hide
// their children. A hidden mesh casts no shadow.

// Returns the meshes, points and lines of a scene, in the order of the result's objects.
function drawables(root) {
  const all = [];
  root.traverse((object) => {
    if (object.isInstancedMesh) {
      throw new Error('this example cannot hide single instances of EXT_mesh_gpu_instancing; bake a file '
        + 'without this extension, or use the lists of instances in SIGHTLINE_visibility');
    }
    if (object.isMesh || object.isPoints || object.isLine) all.push(object);
  });
  return all;
}

const trianglesOf = ({ geometry, isMesh }) =>
  isMesh ? Math.floor((geometry.index ?? geometry.attributes.position).count / 3) : 0;

export class SightlineCuller {
  enabled = true;
  #pvs; #cell = -2; #meshes = []; #objectOf;

  constructor(pvs, root) {
    this.#pvs = pvs;
    const all = drawables(root);
    const fits = all.length === pvs.objects.length
      && all.every((mesh, k) => trianglesOf(mesh) === pvs.objects[k].count);
    if (!fits) {
      throw new Error(`the ${all.length} meshes of the scene do not match the ${pvs.objects.length} objects `
        + 'of the result; load the file that was baked, or bake this file');
    }
    // The object of each triangle, for results whose sets contain triangles or clusters.
    this.#objectOf = new Uint32Array(pvs.triangles);
    pvs.objects.forEach(({ first, count }, k) => this.#objectOf.fill(k, first, first + count));
    // Meshes in no set stay unchanged, because they may move, or consist of points or lines.
    const known = new Set();
    for (let cell = 0; cell < pvs.cells; cell++) for (const k of this.#objectsOf(cell)) known.add(k);
    this.#meshes = all.map((mesh, k) => ({ mesh, mask: mesh.layers.mask, known: known.has(k) }));
  }

  // Returns the objects that are visible from a cell.
  #objectsOf(cell) {
    const items = this.#pvs.visible(cell);
    if (this.#pvs.items.kind === 'objects') return new Set(items);
    const objects = new Set();
    for (const id of this.#pvs.trianglesOf(items)) objects.add(this.#objectOf[id]);
    return objects;
  }

  // Hides the meshes that are not visible from the cell of a point, and returns the cell. Returns -1 and
  // shows all meshes if the point is outside the view box or its cell contains no viewpoint.
  update({ x, y, z }) {
    let cell = this.enabled ? this.#pvs.cellOf(x, y, z) : -1;
    if (cell >= 0 && !this.#pvs.isReached(cell)) cell = -1;
    if (cell !== this.#cell) {
      this.#cell = cell;
      const seen = cell < 0 ? null : this.#objectsOf(cell);
      this.#meshes.forEach(({ mesh, mask, known }, k) => {
        mesh.layers.mask = !known || !seen || seen.has(k) ? mask : 0;
      });
    }
    return cell;
  }
}
