//! CUDA C++ of programs, for NVRTC and nvcc: one state per thread, arrays by components.

use super::c::{Sources, WRITTEN_BY, check, constants, joints, meaning, programs};
use super::case::Case;
use super::functions::{Array, Function};
use super::pieces::{self, Form};
use super::program::Program;
use super::syntax;
use super::width::Width;
use crate::error::Error;
use crate::scene::Scene;
use std::fmt::Write;

/// Generates CUDA sources of functions of a scene under this name: NAME.cu, `test_NAME.cu`, `one_thread.h` and a
/// Makefile.
///
/// Each function is a kernel for many states, `extern "C"`, with one state per thread: `NAME_forward_dynamics(count, q,
/// qd, tau, qdd)`. Element `i` of the array q of state `s` is `q[i * count + s]`, so that adjacent threads read
/// adjacent values. Long programs are split into parts, as in C. NAME.cu has no includes and is compiled at run time by
/// NVRTC, or by nvcc. With `one_thread.h` it is C99, where a loop replaces the threads: `make test-c` compares with the
/// scene without a GPU, `make test` with one.
///
/// # Errors
///
/// As [`Program::new`]; [`Error::Argument`] for a name that is not an identifier of C, and for no functions.
pub fn cuda_sources(scene: &Scene, name: &str, functions: &[Function], width: Width) -> Result<Sources, Error> {
    let programs = programs(scene, name, functions, (width, None))?;
    Ok(vec![
        (format!("{name}.cu"), source(scene, name, &programs, width)),
        ("one_thread.h".to_owned(), ONE_THREAD.to_owned()),
        (format!("test_{name}.cu"), test(scene, name, &programs, width)?),
        ("Makefile".to_owned(), makefile(name)),
    ])
}

/// A header that turns a kernel into C99: its threads run one after another.
const ONE_THREAD: &str = include_str!("templates/one_thread.h");

/// The functions and macros that all kernels use.
fn prelude(width: Width) -> String {
    let (number, f) = (width.of_c(), width.suffix());
    format!(
        "\n__device__ __forceinline__ void sine_and_cosine({number} x, {number} *sine, {number} *cosine)\n{{\n\
         #ifdef __CUDACC__\n    sincos{f}(x, sine, cosine);\n#else\n    *sine = sin{f}(x);\n    *cosine = cos{f}(x);\n#endif\n}}\n\n\
         #if defined(__CUDACC__)\n#define APART __noinline__\n#else\n#define APART\n#endif\n\n\
         #ifdef __cplusplus\nextern \"C\" {{\n#endif\n"
    )
}

fn source(scene: &Scene, name: &str, programs: &[Program], width: Width) -> String {
    let mut text = format!("{WRITTEN_BY}/* SI units, radians. Joints, and where they are in q and in qd:\n");
    for line in joints(scene) {
        let _ = writeln!(text, "   {line}");
    }
    text.push_str("*/\n");
    text.push_str(&prelude(width));
    for program in programs {
        let _ = write!(text, "\n/* {} */\n", meaning(program));
        kernel(name, program, width, &mut text);
    }
    text.push_str("\n#ifdef __cplusplus\n}\n#endif\n");
    text
}

fn kernel(name: &str, program: &Program, width: Width, text: &mut String) {
    let number = width.of_c();
    let parameters = program.named(&format!("const {number} *__restrict__ "), &format!("{number} *__restrict__ "));
    let name = format!("{name}_{}", program.function.symbol());
    let form = Form {
        syntax: &syntax::CUDA,
        width,
        head: format!("\n__global__ void {name}(unsigned long long count, {parameters})\n{{\n{THREAD}"),
        tail: "}\n".to_owned(),
        name,
        parameters: format!("unsigned long long count, unsigned long long state, {parameters}"),
        names: format!("count, state, {}", program.named("", "")),
        is_apart: true,
    };
    text.extend(pieces::write(program, &form));
}

/// The state of a thread.
const THREAD: &str = "    const unsigned long long state = (unsigned long long)blockIdx.x * blockDim.x + threadIdx.x;\n    \
                      if (state >= count) return;\n";

/// Some states, and the results of the methods there: on a GPU by nvcc, otherwise one thread after another.
fn test(scene: &Scene, name: &str, programs: &[Program], width: Width) -> Result<String, Error> {
    const STATES: usize = 70;
    let number = width.of_c();
    let mut text = format!(
        "{WRITTEN_BY}#include <math.h>\n#include <stddef.h>\n#include <stdio.h>\n#include <stdlib.h>\n\n\
         #ifdef __CUDACC__\n#define ON_ALL_THREADS(count, call)\n#else\n#include \"one_thread.h\"\n#endif\n#include \"{name}.cu\"\n\n\
         #define STATES {STATES}\n\n{}\n\
         /* Numbers of all states, where kernels reach them. */\nstatic {number} *room(size_t count)\n{{\n    \
         void *there = NULL;\n#ifdef __CUDACC__\n    \
         if (cudaMallocManaged(&there, count * sizeof({number})) != cudaSuccess) there = NULL;\n#else\n    \
         there = malloc(count * sizeof({number}));\n#endif\n    \
         if (there == NULL) {{\n        printf(\"no room, or no GPU\\n\");\n        exit(2);\n    }}\n    \
         return ({number} *)there;\n}}\n\n\
         /* The same numbers for each state. */\nstatic {number} *repeated(const {number} *values, size_t width)\n{{\n    \
         {number} *all = room(width * STATES + 1);\n    \
         for (size_t i = 0; i < width * STATES; i++) all[i] = values[i / STATES];\n    return all;\n}}\n\n\
         int main(void)\n{{\n    int faults = 0;\n",
        check(width)
    );
    for program in programs {
        let (case, function) = (Case::new(scene, program)?, program.function.symbol());
        text.push_str("    {\n");
        let mut names = Vec::new();
        for (array, values) in program.arguments.iter().zip(&case.given) {
            let _ = writeln!(text, "        {}", constants(&format!("one_{}", array.name), values, width));
            let _ =
                writeln!(text, "        {number} *{} = repeated(one_{}, {});", array.name, array.name, array.width());
            names.push(array.name.to_owned());
        }
        let (mut first, mut checks) = (0, String::new());
        for (name, count) in Array::sized(&program.results) {
            let expected = constants(&format!("expected_{name}"), &case.expected[first..first + count], width);
            let _ = write!(text, "        {expected}\n        {number} *{name} = room({count} * STATES + 1);\n");
            let size = case.size;
            let _ = writeln!(
                checks,
                "        faults += check(\"{function}: {name}\", {name}, repeated(expected_{name}, {count}), {count} * STATES, {size:?});"
            );
            names.push(name.to_owned());
            first += count;
        }
        let all = names.join(", ");
        let _ = write!(
            text,
            "#ifdef __CUDACC__\n        {name}_{function}<<<(STATES + 31) / 32, 32>>>(STATES, {all});\n        \
             if (cudaDeviceSynchronize() != cudaSuccess) faults++;\n#else\n        \
             ON_ALL_THREADS(STATES, {name}_{function}(STATES, {all}))\n#endif\n{checks}    }}\n"
        );
    }
    text.push_str("    return faults != 0;\n}\n");
    Ok(text)
}

fn makefile(name: &str) -> String {
    format!(
        "# Written by phipsi. make test: by nvcc, on a GPU. make test-c: by the C compiler, one thread after another.\n\
         NVCC ?= nvcc\nNVCCFLAGS ?= -O3 -arch=native\nCFLAGS ?= -std=c99 -O2\n\n\
         test: test_{name}.cu {name}.cu\n\t$(NVCC) $(NVCCFLAGS) test_{name}.cu -o test_{name}\n\t./test_{name}\n\n\
         test-c: test_{name}.cu {name}.cu one_thread.h\n\t$(CC) $(CFLAGS) -x c test_{name}.cu -lm -o test_{name}_c\n\t./test_{name}_c\n\n\
         .PHONY: test test-c\n"
    )
}
