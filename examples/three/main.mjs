// A walk through a scene in three.js, with the numbers of draw calls with and without culling:
// ?scene=level.glb&pvs=level.pvs

import * as THREE from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import { Pvs } from '../../readers/js/pvs.mjs';
import { SightlineCuller } from './culler.mjs';

const page = new URLSearchParams(location.search);
const [status, toggle] = ['status', 'culling'].map((id) => document.getElementById(id));

const renderer = new THREE.WebGLRenderer({ canvas: document.querySelector('canvas') });
const camera = new THREE.PerspectiveCamera(70, 1, 0.05, 10000);
camera.rotation.order = 'YXZ';
const scene = new THREE.Scene();
scene.background = new THREE.Color(0x223344);
scene.add(new THREE.HemisphereLight(0xffffff, 0x443322, 3));

// Draws a frame, and returns the cell of the camera and the number of draw calls.
function draw(culler, culled) {
  culler.enabled = culled;
  const cell = culler.update(camera.position);
  renderer.render(scene, camera);
  return { cell, calls: renderer.info.render.calls };
}

async function start() {
  const [gltf, bytes] = await Promise.all([
    new GLTFLoader().loadAsync(page.get('scene') ?? 'level.glb'),
    fetch(page.get('pvs') ?? 'level.pvs').then((answer) => {
      if (!answer.ok) throw new Error(`${answer.url}: ${answer.status}`);
      return answer.arrayBuffer();
    }),
  ]);
  const pvs = Pvs.parse(bytes);
  scene.add(gltf.scene);
  gltf.scene.updateMatrixWorld(true);
  const culler = new SightlineCuller(pvs, gltf.scene);
  // The walk begins in the centre of the first cell with viewpoints.
  const first = [...Array(pvs.cells).keys()].find((cell) => pvs.isReached(cell)) ?? 0;
  const box = pvs.boxes.subarray(6 * first, 6 * first + 6);
  camera.position.set((box[0] + box[3]) / 2, (box[1] + box[4]) / 2, (box[2] + box[5]) / 2);
  return { THREE, renderer, scene, camera, pvs, culler, draw: (culled) => draw(culler, culled) };
}

// The keys W, A, S, D, E and Q move the camera. Dragging the pointer rotates the camera.
const keys = new Set();
addEventListener('keydown', (event) => keys.add(event.code));
addEventListener('keyup', (event) => keys.delete(event.code));
renderer.domElement.addEventListener('pointermove', (event) => {
  if (!event.buttons) return;
  camera.rotation.y -= event.movementX / 300;
  camera.rotation.x = Math.max(-1.5, Math.min(1.5, camera.rotation.x - event.movementY / 300));
});
function move(seconds) {
  const key = (plus, minus) => keys.has(`Key${plus}`) - keys.has(`Key${minus}`);
  const step = new THREE.Vector3(key('D', 'A'), key('E', 'Q'), key('S', 'W')).multiplyScalar(4 * seconds);
  camera.position.add(step.applyEuler(camera.rotation));
}

// A promise of the loaded scene, for other scripts such as the tests.
globalThis.example = start();
const example = await globalThis.example.catch((error) => { status.textContent = error.message; });
let last = performance.now();
if (example && !page.has('still')) {
  renderer.setAnimationLoop((now) => {
    move((now - last) / 1000);
    last = now;
    const [width, height] = [innerWidth, innerHeight];
    renderer.setSize(width, height, false);
    camera.aspect = width / height;
    camera.updateProjectionMatrix();
    // The page draws each frame twice to compare the draw calls. A game draws a frame once.
    const other = example.draw(!toggle.checked), shown = example.draw(toggle.checked);
    const [on, off] = toggle.checked ? [shown, other] : [other, shown];
    status.textContent = `${on.calls} draw calls with culling, ${off.calls} without; `
      + (on.cell < 0 ? 'no cell: all meshes are drawn' : `cell ${on.cell}`);
  });
}
