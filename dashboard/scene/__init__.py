"""The picture: scene, camera, meshes, selection."""
