//! Where an address of this process lies in shared memory, and segments made resident before they are needed.

use std::fs::{self, OpenOptions};
use std::io;
use std::os::unix::fs::MetadataExt;

use rustix::fs::FallocateFlags;
use rustix::mm::{Advice, madvise};

use crate::domain::Domain;

/// A place in a shared-memory file. Two processes that report the same place look at the same bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SegmentLocation {
    /// Inode of the file in `/dev/shm`.
    pub inode: u64,
    /// Bytes from the beginning of the file.
    pub offset: u64,
}

/// One line of `/proc/self/maps`.
#[derive(Debug, PartialEq, Eq)]
struct Mapping<'a> {
    begin: usize,
    end: usize,
    writable: bool,
    offset: u64,
    inode: u64,
    path: &'a str,
}

fn parse_line(line: &str) -> Option<Mapping<'_>> {
    let mut fields = line.splitn(6, ' ');
    let (begin, end) = fields.next()?.split_once('-')?;
    let permissions = fields.next()?;
    let offset = fields.next()?;
    let _device = fields.next()?;
    let inode = fields.next()?;
    Some(Mapping {
        begin: usize::from_str_radix(begin, 16).ok()?,
        end: usize::from_str_radix(end, 16).ok()?,
        writable: permissions.contains('w'),
        offset: u64::from_str_radix(offset, 16).ok()?,
        inode: inode.parse().ok()?,
        path: fields.next().unwrap_or("").trim_start(),
    })
}

/// The place in a shared file behind an address, if there is one.
pub(super) fn locate<T>(address: *const T) -> Option<SegmentLocation> {
    let address = address as usize;
    let maps = fs::read_to_string("/proc/self/maps").ok()?;
    let mapping = maps.lines().filter_map(parse_line).find(|m| (m.begin..m.end).contains(&address))?;
    let inside = (address - mapping.begin) as u64;
    (mapping.inode != 0).then_some(SegmentLocation { inode: mapping.inode, offset: mapping.offset + inside })
}

/// Allocates every data segment of the domain in full, so that a full `/dev/shm` is an error here and never a SIGBUS
/// later, and maps the pages of those this process can write.
///
/// # Errors
/// `StorageFull` when `/dev/shm` has no room.
pub(super) fn prefault(domain: &Domain) -> io::Result<()> {
    for path in domain.segments() {
        if path.extension().is_none_or(|e| e != "data") {
            continue;
        }
        // A segment of a publisher that has just ended may be gone by now.
        let Ok(file) = OpenOptions::new().read(true).write(true).open(&path) else { continue };
        let meta = file.metadata()?;
        if meta.blocks() * 512 < meta.size() {
            rustix::fs::fallocate(&file, FallocateFlags::empty(), 0, meta.size())?;
        }
    }
    let prefix = format!("{}/{}", crate::domain::SHM, domain.prefix());
    let maps = fs::read_to_string("/proc/self/maps")?;
    for mapping in maps.lines().filter_map(parse_line) {
        if mapping.writable && mapping.path.starts_with(&prefix) && mapping.path.ends_with(".data") {
            populate(&mapping);
        }
    }
    Ok(())
}

/// Maps all pages of a segment for writing.
fn populate(mapping: &Mapping<'_>) {
    let begin = std::ptr::with_exposed_provenance_mut(mapping.begin);
    // SAFETY: the range is one mapping of this process, read from /proc/self/maps just now and owned by a publisher of
    // the calling thread, so nobody unmaps it meanwhile. Populating changes no byte of it. On kernels before 5.14 the
    // call fails without effect, and pages are mapped at the first touch instead.
    let _ = unsafe { madvise(begin, mapping.end - mapping.begin, Advice::LinuxPopulateWrite) };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_of_the_map_is_read_with_all_its_fields() {
        let line =
            "7f10a0000000-7f10a0100000 rw-s 00002000 00:19 4242                       /dev/shm/mirador.0.a.x.data";
        assert_eq!(
            parse_line(line),
            Some(Mapping {
                begin: 0x7f10_a000_0000,
                end: 0x7f10_a010_0000,
                writable: true,
                offset: 0x2000,
                inode: 4242,
                path: "/dev/shm/mirador.0.a.x.data",
            })
        );
        assert_eq!(parse_line("nonsense"), None);
    }

    #[test]
    fn memory_of_the_process_itself_is_in_no_file() {
        let value = Box::new(1_u8);
        assert_eq!(locate(&raw const *value), None);
    }
}
