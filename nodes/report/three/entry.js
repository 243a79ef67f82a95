export {
  WebGLRenderer, Scene, PerspectiveCamera, BufferGeometry, BufferAttribute, Mesh, LineSegments, Line, Group,
  ShaderMaterial, LineBasicMaterial, MeshStandardMaterial, MeshLambertMaterial, LatheGeometry, Vector2, Vector3, Quaternion, Color,
  HemisphereLight, DirectionalLight, ArrowHelper, DoubleSide, Box3, Sphere, Spherical, Raycaster, MOUSE
} from 'three';
export { OrbitControls } from 'three/examples/jsm/controls/OrbitControls.js';
