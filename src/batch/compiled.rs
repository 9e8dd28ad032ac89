//! The kernels of every scalar and instruction set, one module each.
//!
//! The compiler distributes work by modules, and a kernel is one function into which all algorithms are inlined. In a
//! single module the instruction sets would be compiled one after another.

#[cfg(all(target_arch = "aarch64", feature = "lanes"))]
use pulp::aarch64::Neon;
#[cfg(all(target_arch = "x86_64", feature = "lanes"))]
use pulp::x86::V3;
#[cfg(all(target_arch = "x86_64", feature = "avx512"))]
use pulp::x86::V4;

macro_rules! compiled {
    ($module:ident, $scalar:ty) => {
        compiled!($module, $scalar, <$scalar as crate::batch::instruction_set::Vectorized>::Least);
    };
    ($module:ident, $scalar:ty, $instructions:ty) => {
        pub(super) mod $module {
            #[allow(unused_imports)] // each scalar needs some of them
            use super::*;
            use crate::algorithm::{Algorithm, Arguments, Chunks, KinematicQuantity};
            use crate::batch::chunk::Chunk;
            use crate::batch::instruction_set::Target;
            #[cfg(feature = "lanes")]
            #[allow(unused_imports)]
            use crate::scalar::{Fused, Lanes};
            use crate::scene::Scene;

            struct Compiled(Chunk<$scalar>, $instructions);

            impl Chunks for Compiled {
                fn lanes(&self) -> usize {
                    Chunk::<$scalar>::lanes()
                }

                fn run(&mut self, algorithm: Algorithm, states: &[Arguments<'_>], out: &mut [f64]) -> u64 {
                    self.0.run(self.1, algorithm, states, out)
                }

                fn kinematic_quantity(
                    &mut self,
                    what: &KinematicQuantity<'_>,
                    states: &[Arguments<'_>],
                    out: &mut [f64],
                ) -> u64 {
                    self.0.kinematic_quantity(self.1, what, states, out)
                }

                fn error(&self, lane: usize) -> f64 {
                    self.0.error(lane)
                }
            }

            /// The kernels for `scene`, with scratch, if this processor has the instructions.
            pub fn kernels(scene: &Scene) -> Option<Box<dyn Chunks>> {
                let target = <$instructions>::here()?;
                Some(Box::new(Compiled(Chunk::new(scene), target)))
            }
        }
    };
}

compiled!(plain, f64);
#[cfg(all(feature = "lanes", any(target_arch = "x86_64", target_arch = "aarch64")))]
compiled!(fused, Fused);
// The same number of lanes, in twice the number of registers.
#[cfg(all(target_arch = "x86_64", feature = "avx512"))]
compiled!(fused_avx512, Fused, V4);
#[cfg(all(target_arch = "x86_64", feature = "lanes"))]
compiled!(avx2, Lanes<V3>);
#[cfg(all(target_arch = "x86_64", feature = "avx512"))]
compiled!(avx512, Lanes<V4>);
#[cfg(all(target_arch = "aarch64", feature = "lanes"))]
compiled!(neon, Lanes<Neon>);
