// What nodes/report/web/report.js uses of three.js.
export {
  BufferAttribute, BufferGeometry, DirectionalLight, Group, HemisphereLight, LatheGeometry, Line, LineBasicMaterial, LineSegments, Mesh,
  MeshLambertMaterial, PerspectiveCamera, Scene, ShaderMaterial, Vector2, Vector3, WebGLRenderer, DoubleSide,
} from 'three';
export { OrbitControls } from 'three/examples/jsm/controls/OrbitControls.js';
