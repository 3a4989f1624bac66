//! Tests of the kernels against their CPU twins. Those that need an adapter take the first one there is, lavapipe as well, and
//! say so when there is none.

mod shaders;
