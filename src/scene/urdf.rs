//! Scenes from URDF.
