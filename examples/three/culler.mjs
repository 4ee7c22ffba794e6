// Hides the meshes of a three.js scene that are not visible from the cell of the camera.
//
//   const culler = new SightlineCuller(Pvs.parse(bytes), gltf.scene);
//   culler.update(camera.position);            // each frame, before renderer.render
//
// The scene is what GLTFLoader makes of the file that was baked. Its meshes are matched with the result's objects in
// their order, which GLTFLoader keeps (nodes depth first, primitives in order), and by their numbers of triangles.
// Meshes are hidden by their layers: `visible = false` would hide their children as well. What three.js does with
// layers holds for shadows too: a hidden mesh casts none.

// The objects with triangles that GLTFLoader made, in the order of the result.
function drawables(root) {
  const all = [];
  root.traverse((object) => {
    if (object.isInstancedMesh) {
      throw new Error('instances are one draw call; this example does not split them: bake without '
        + 'EXT_mesh_gpu_instancing, or use the lists of instances in SIGHTLINE_visibility');
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
      throw new Error(`the scene's ${all.length} meshes are not the ${pvs.objects.length} objects of the result; `
        + 'load the file that was baked, or bake this one');
    }
    // The object of each triangle, where sets are of triangles.
    this.#objectOf = new Uint32Array(pvs.triangles);
    pvs.objects.forEach(({ first, count }, k) => this.#objectOf.fill(k, first, first + count));
    // What is in no set at all stays as it is: it may move, or be points or lines.
    const known = new Set();
    for (let cell = 0; cell < pvs.cells; cell++) for (const k of this.#objectsOf(cell)) known.add(k);
    this.#meshes = all.map((mesh, k) => ({ mesh, mask: mesh.layers.mask, known: known.has(k) }));
  }

  // The objects that are visible from a cell.
  #objectsOf(cell) {
    const items = this.#pvs.visible(cell);
    if (this.#pvs.items.kind === 'objects') return new Set(items);
    const objects = new Set();
    for (const id of this.#pvs.trianglesOf(items)) objects.add(this.#objectOf[id]);
    return objects;
  }

  // Hides what is not visible from the point's cell, and returns the cell; -1 where nothing is known, so that
  // everything is drawn.
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
