//! Allocation of buffers whose size the caller determines, with [`Error::Memory`] instead of an abort.
//!
//! A failed allocation aborts the Rust process, including a Python interpreter in it. On Linux an allocation can also
//! succeed without available memory, because pages are assigned at the first write, and the system then kills the
//! process. Therefore large requests are compared with the available memory before they are passed to the allocator.

use crate::error::Error;

/// Requests below this many bytes are passed to the allocator without reading the available memory, which takes as long
/// as filling some megabytes.
const LARGE: u128 = 64 << 20;

/// One part in this many of the available memory is reserved for other processes.
const SPARE: u128 = 32;

/// Checks that `bytes` bytes can be allocated for the named argument.
///
/// Reserves and releases the memory, because the allocator knows the limits of the process, and compares large requests
/// with the available memory.
///
/// # Errors
///
/// [`Error::Memory`].
pub fn room(argument: &str, bytes: u128) -> Result<(), Error> {
    let asked = usize::try_from(bytes).ok().filter(|&bytes| Vec::<u8>::new().try_reserve_exact(bytes).is_ok());
    let refused = |free| Err(Error::memory(argument, bytes, free));
    if bytes < LARGE {
        return if asked.is_some() { Ok(()) } else { refused(None) };
    }
    match free() {
        Some(free) if bytes > free - free / SPARE => refused(Some(free)),
        _ if asked.is_none() => refused(None),
        _ => Ok(()),
    }
}

/// Size in bytes of an array of `T` with the given lengths per axis; saturates instead of overflowing.
#[must_use]
pub fn bytes_of<T>(factors: &[usize]) -> u128 {
    let each = size_of::<T>() as u128;
    factors.iter().fold(each, |bytes, &factor| bytes.saturating_mul(factor as u128))
}

/// An empty vector with capacity for `length` entries, requested by the named argument.
///
/// # Errors
///
/// [`Error::Memory`].
pub fn with_capacity<T>(argument: &str, length: usize) -> Result<Vec<T>, Error> {
    let bytes = bytes_of::<T>(&[length]);
    if bytes >= LARGE {
        room(argument, bytes)?;
    }
    let mut vector = Vec::new();
    let refused = |_| Error::memory(argument, bytes, None);
    vector.try_reserve_exact(length).map_err(refused)?;
    Ok(vector)
}

/// A vector of `length` equal entries, requested by the named argument.
///
/// # Errors
///
/// [`Error::Memory`].
pub fn filled<T: Clone>(argument: &str, length: usize, value: T) -> Result<Vec<T>, Error> {
    let mut vector = with_capacity(argument, length)?;
    vector.resize(length, value);
    Ok(vector)
}

/// A copy of `entries`, which belong to the named argument.
///
/// # Errors
///
/// [`Error::Memory`].
pub fn copied<T: Copy>(argument: &str, entries: &[T]) -> Result<Vec<T>, Error> {
    let mut vector = with_capacity(argument, entries.len())?;
    vector.extend_from_slice(entries);
    Ok(vector)
}

/// Memory available to this process in bytes, if the system reports it: the minimum over the machine and the control
/// groups of the process.
fn free() -> Option<u128> {
    let machine = std::fs::read_to_string("/proc/meminfo").ok().and_then(|text| of_machine(&text));
    let groups = std::fs::read_to_string("/proc/self/cgroup").ok().and_then(|text| of_groups(&text));
    machine.into_iter().chain(groups).min()
}

/// Available memory plus free swap, from /proc/meminfo.
fn of_machine(meminfo: &str) -> Option<u128> {
    let entry = |name: &str| -> Option<u128> {
        let line = meminfo.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(':'))?;
        Some(1024 * line.trim().strip_suffix("kB")?.trim().parse::<u128>().ok()?)
    };
    Some(entry("MemAvailable")? + entry("SwapFree").unwrap_or(0))
}

/// The least memory left in a control group of the process or an ancestor of it, for version 2 (`0::/path`) and version
/// 1 (`7:memory:/path`).
fn of_groups(own: &str) -> Option<u128> {
    let of_line = |line: &str| -> Option<u128> {
        let mut fields = line.splitn(3, ':').skip(1);
        let (controllers, path) = (fields.next()?, fields.next()?);
        let (root, limit, used) = if controllers.is_empty() {
            ("/sys/fs/cgroup", "memory.max", "memory.current")
        } else if controllers.split(',').any(|controller| controller == "memory") {
            ("/sys/fs/cgroup/memory", "memory.limit_in_bytes", "memory.usage_in_bytes")
        } else {
            return None;
        };
        let ancestors = std::path::Path::new(path).ancestors();
        ancestors.filter_map(|group| of_group(&format!("{root}{}", group.display()), limit, used)).min()
    };
    own.lines().filter_map(of_line).min()
}

/// The limit of one group minus its usage. The inactive file cache does not count, because the kernel can drop it.
fn of_group(folder: &str, limit: &str, used: &str) -> Option<u128> {
    let read = |file: &str| std::fs::read_to_string(format!("{folder}/{file}")).ok();
    let number = |file: &str| -> Option<u128> { read(file)?.trim().parse().ok() };
    // "max", the entry of a group without a limit, does not parse as a number.
    let (limit, used) = (number(limit)?, number(used)?);
    let statistics = read("memory.stat").unwrap_or_default();
    let droppable =
        statistics.lines().find_map(|line| line.strip_prefix("inactive_file ")?.trim().parse::<u128>().ok());
    Some(limit.saturating_sub(used.saturating_sub(droppable.unwrap_or(0))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_refused_names_argument_and_bytes() {
        for refused in [
            filled("samples", usize::MAX, 0.0_f64).map(|_| ()),
            filled("samples", isize::MAX.unsigned_abs() / 16, 0.0_f64).map(|_| ()),
            with_capacity::<[f64; 7]>("samples", 1 << 50).map(|_| ()),
            room("samples", bytes_of::<f64>(&[usize::MAX, usize::MAX, 3])),
            room("samples", 1 << 60),
        ] {
            let error = refused.expect_err("more than there is");
            let Error::Memory { argument, request } = &error else { panic!("{error}") };
            assert_eq!(argument, "samples");
            assert!(error.to_string().starts_with("samples: no room for "), "{error}");
            assert!(error.to_string().contains(&request.bytes.to_string()), "{error}");
        }
    }

    #[test]
    fn what_there_is_room_for_is_given() -> Result<(), Error> {
        assert_eq!(filled("q", 3, 1.5)?, [1.5; 3]);
        assert_eq!(copied("q", &[1, 2])?, [1, 2]);
        assert!(with_capacity::<f64>("q", 9)?.capacity() >= 9);
        room("q", 0)?;
        room("q", LARGE)
    }

    #[test]
    fn what_the_kernel_writes_is_read() {
        let text =
            "MemTotal:       24683656 kB\nMemAvailable:   1000 kB\nSwapTotal: 5 kB\nSwapFree:              24 kB\n";
        assert_eq!(of_machine(text), Some(1024 * 1024));
        assert_eq!(of_machine("nothing"), None);
        assert_eq!(of_groups("3:cpu:/\nnonsense\n"), None);
    }
}
