//! The kernels of every scalar, each in a module of its own.
//!
//! The compiler hands out its work by modules, and a kernel is all of the algorithms inlined into one function: in one module the arms would
//! be compiled one after another.

#[cfg(target_arch = "aarch64")]
use pulp::aarch64::Neon;
#[cfg(target_arch = "x86_64")]
use pulp::x86::{V3, V4};

macro_rules! compiled {
    ($module:ident, $scalar:ty) => {
        pub(super) mod $module {
            #[allow(unused_imports)] // each scalar needs some of them
            use super::*;
            use crate::batch::arms::Vectorised;
            use crate::batch::chunk::{Algorithm, Arguments, Chunk, Chunks};
            #[allow(unused_imports)]
            use crate::scalar::{Fused, Lanes};
            use crate::scene::Scene;

            type Number = <$scalar as Vectorised>::Number;

            struct Compiled(Chunk<$scalar>);

            impl Chunks<Number> for Compiled {
                fn lanes(&self) -> usize {
                    self.0.lanes()
                }

                fn run(&mut self, algorithm: Algorithm, states: &[Arguments<'_, Number>], out: &mut [Number]) -> u64 {
                    self.0.run(algorithm, states, out)
                }
            }

            /// The kernels for `scene`, with scratch.
            pub fn kernels(scene: &Scene) -> Box<dyn Chunks<Number>> {
                Box::new(Compiled(Chunk::new(scene)))
            }
        }
    };
}

compiled!(plain, f64);
compiled!(fused, Fused);
#[cfg(target_arch = "x86_64")]
compiled!(avx2, Lanes<V3>);
#[cfg(target_arch = "x86_64")]
compiled!(avx512, Lanes<V4>);
#[cfg(target_arch = "x86_64")]
compiled!(avx2_f32, Lanes<V3, f32>);
#[cfg(target_arch = "x86_64")]
compiled!(avx512_f32, Lanes<V4, f32>);
#[cfg(target_arch = "aarch64")]
compiled!(neon, Lanes<Neon>);
#[cfg(target_arch = "aarch64")]
compiled!(neon_f32, Lanes<Neon, f32>);
