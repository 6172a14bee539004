use std::collections::VecDeque;

use super::fields::Fields;
use super::{MAGIC, UNDEFINED};
use crate::FileProblem;

/// Longest name of a member of a group.
const MAX_NAME: usize = 4096;

/// Message types of section IV.A.2.
pub(super) mod message {
    pub(in crate::codec::hdf5) const DATASPACE: u16 = 0x01;
    pub(in crate::codec::hdf5) const LINK_INFO: u16 = 0x02;
    pub(in crate::codec::hdf5) const DATATYPE: u16 = 0x03;
    pub(in crate::codec::hdf5) const LINK: u16 = 0x06;
    pub(in crate::codec::hdf5) const LAYOUT: u16 = 0x08;
    pub(in crate::codec::hdf5) const FILTERS: u16 = 0x0b;
    pub(in crate::codec::hdf5) const CONTINUATION: u16 = 0x10;
    pub(in crate::codec::hdf5) const SYMBOL_TABLE: u16 = 0x11;
}

/// Address of the root group's object header (section II.A).
pub(super) fn root_group(file: &[u8]) -> Result<u64, FileProblem> {
    let mut fields = Fields::new(file, "superblock");
    fields.signature(MAGIC)?;
    let version = fields.one_of("superblock version", &[0, 1, 2, 3])?;
    if version < 2 {
        fields.bytes(4)?; // versions of other structures
    }
    fields.one_of("size of offsets", &[8])?;
    fields.one_of("size of lengths", &[8])?;
    fields.bytes(match version {
        0 => 1 + 4 + 4, // reserved, ranks of groups' B-trees, flags
        1 => 1 + 4 + 4 + 4,
        _ => 1, // flags
    })?;
    if fields.u64()? != 0 {
        return Err(FileProblem::field("base address", "0", "another"));
    }
    fields.u64()?; // free space or superblock extension
    let end = fields.u64()?;
    if end != file.len() as u64 {
        let what =
            if end > file.len() as u64 { "the file is truncated" } else { "something follows the data" };
        return Err(FileProblem::field(
            "end of file address",
            format!("{}, the size of the file", file.len()),
            format!("{end}: {what}"),
        ));
    }
    if version < 2 {
        fields.u64()?; // driver information
        fields.u64()?; // name of the root group
    }
    fields.u64()
}

/// The messages (types and contents) of the object header at `address` (section IV.A.1).
pub(super) fn messages(file: &[u8], address: u64) -> Result<Vec<(u16, &[u8])>, FileProblem> {
    const NAME: &str = "object header";
    let mut fields = Fields::at(file, address, NAME)?;
    let mut messages = Messages { file, list: Vec::new(), blocks: VecDeque::new() };
    if fields.clone().signature(b"OHDR").is_ok() {
        fields.bytes(4)?;
        fields.one_of("object header version", &[2])?;
        let flags = fields.u8()?;
        fields.bytes(if flags & 0x20 != 0 { 16 } else { 0 })?; // times
        fields.bytes(if flags & 0x10 != 0 { 4 } else { 0 })?; // attribute counts
        let size = fields.number(1 << (flags & 3))?;
        let block = fields.bytes(usize::try_from(size).unwrap_or(usize::MAX))?;
        messages.read_all(block, Version::Two { creation_order: flags & 4 != 0 })?;
    } else {
        fields.one_of("object header version", &[1])?;
        fields.bytes(1 + 2 + 4)?; // reserved, number of messages, references
        let size = fields.u32()? as usize;
        fields.bytes(4)?; // padding to a multiple of 8
        messages.read_all(fields.bytes(size)?, Version::One)?;
    }
    Ok(messages.list)
}

#[derive(Clone, Copy)]
enum Version {
    One,
    Two { creation_order: bool },
}

struct Messages<'a> {
    file: &'a [u8],
    list: Vec<(u16, &'a [u8])>,
    blocks: VecDeque<&'a [u8]>,
}

impl<'a> Messages<'a> {
    fn read_all(&mut self, first: &'a [u8], version: Version) -> Result<(), FileProblem> {
        // Blocks do not overlap, so together they are no longer than the file: this detects loops.
        let mut bytes_left = self.file.len();
        self.blocks.push_back(first);
        while let Some(block) = self.blocks.pop_front() {
            bytes_left = bytes_left.checked_sub(block.len().max(1)).ok_or_else(|| {
                FileProblem::field("object header", "a list of blocks", "a cycle of blocks")
            })?;
            self.read_block(block, version)?;
        }
        Ok(())
    }

    fn read_block(&mut self, block: &'a [u8], version: Version) -> Result<(), FileProblem> {
        let mut fields = Fields::new(block, "object header message");
        let prefix = match version {
            Version::One => 8,
            Version::Two { creation_order: false } => 4,
            Version::Two { creation_order: true } => 6,
        };
        while fields.remaining() >= prefix {
            let kind = match version {
                Version::One => fields.u16()?,
                Version::Two { .. } => fields.u8()?.into(),
            };
            let size = fields.u16()?;
            let flags = fields.u8()?;
            fields.bytes(match version {
                Version::One => 3,
                Version::Two { creation_order } => 2 * usize::from(creation_order),
            })?;
            let data = fields.bytes(size.into())?;
            const SHARED: u8 = 2;
            match kind {
                message::CONTINUATION => self.continue_at(data, version)?,
                message::DATATYPE | message::DATASPACE | message::FILTERS if flags & SHARED != 0 => {
                    return Err(FileProblem::field(
                        "object header message",
                        "its own contents",
                        "shared ones",
                    ));
                }
                _ => self.list.push((kind, data)),
            }
        }
        Ok(())
    }

    fn continue_at(&mut self, data: &[u8], version: Version) -> Result<(), FileProblem> {
        const NAME: &str = "object header continuation";
        let mut fields = Fields::new(data, NAME);
        let mut block = Fields::at(self.file, fields.u64()?, NAME)?;
        let length = usize::try_from(fields.u64()?).unwrap_or(usize::MAX);
        let block = block.bytes(length)?;
        self.blocks.push_back(match version {
            Version::One => block,
            Version::Two { .. } => {
                let mut block = Fields::new(block, NAME);
                block.signature(b"OCHK")?;
                let inside = block.remaining().saturating_sub(4); // ends with a checksum
                block.bytes(inside)?
            }
        });
        Ok(())
    }
}

/// Address of the object header of `name` in the root group.
pub(super) fn find_in_root(file: &[u8], name: &str) -> Result<u64, FileProblem> {
    let root = messages(file, root_group(file)?)?;
    let links = links(file, &root, &mut LinkBudget::new(file))?;
    let found = links.into_iter().find(|(link, _)| *link == name.as_bytes()).map(|(_, address)| address);
    found.ok_or_else(|| {
        FileProblem::field("root group", format!("a dataset `{name}`"), "no dataset of this name")
    })
}

/// What all groups of a file together may take to read: their nodes and names have places of their own, so that more bytes
/// than the file has mean a loop.
pub(super) struct LinkBudget {
    nodes: usize,
    names: usize,
}

impl LinkBudget {
    pub(super) fn new(file: &[u8]) -> Self {
        Self { nodes: file.len(), names: file.len() }
    }

    fn take(left: &mut usize, bytes: usize) -> Result<(), FileProblem> {
        let after = left.checked_sub(bytes);
        *left =
            after.ok_or_else(|| FileProblem::field("group", "a tree", "a cycle, or parts that overlap"))?;
        Ok(())
    }
}

/// Names and addresses of what a group holds, from its messages; nothing for a dataset.
pub(super) fn links<'a>(
    file: &'a [u8],
    messages: &[(u16, &'a [u8])],
    budget: &mut LinkBudget,
) -> Result<Vec<(&'a [u8], u64)>, FileProblem> {
    let mut links = Vec::new();
    for (kind, data) in messages {
        match *kind {
            message::SYMBOL_TABLE => read_symbol_table(file, data, &mut links, budget)?,
            message::LINK => links.extend(hard_link(data)?),
            message::LINK_INFO => {
                let mut fields = Fields::new(data, "link info");
                fields.one_of("link info version", &[0])?;
                let flags = fields.u8()?;
                fields.bytes(if flags & 1 != 0 { 8 } else { 0 })?; // largest creation order
                if fields.u64()? != UNDEFINED {
                    let found = "a heap of links, as of groups with many members in new files";
                    return Err(FileProblem::field("group", "links in its header (h5py's default)", found));
                }
            }
            _ => {}
        }
    }
    links.retain(|(_, address)| *address != UNDEFINED);
    Ok(links)
}

/// A group of the old kind (sections III.A.1, III.B to III.D): a B-tree of symbol nodes and a heap of names.
fn read_symbol_table<'a>(
    file: &'a [u8],
    data: &[u8],
    links: &mut Vec<(&'a [u8], u64)>,
    budget: &mut LinkBudget,
) -> Result<(), FileProblem> {
    let mut fields = Fields::new(data, "symbol table message");
    let (tree, heap) = (fields.u64()?, fields.u64()?);
    let mut heap = Fields::at(file, heap, "local heap")?;
    heap.signature(b"HEAP")?;
    heap.bytes(4 + 8 + 8)?; // version, size, free list
    let names = heap.u64()?;

    let mut waiting = vec![tree];
    while let Some(address) = waiting.pop() {
        let mut node = Fields::at(file, address, "group B-tree")?;
        if node.clone().signature(b"SNOD").is_ok() {
            node.bytes(4 + 2)?; // signature, version, reserved
            let entries = node.u16()?;
            LinkBudget::take(&mut budget.nodes, 8 + 40 * usize::from(entries))?;
            for _ in 0..entries {
                let (entry_name, header) = (node.u64()?, node.u64()?);
                node.bytes(4 + 4 + 16)?; // cache
                let text = Fields::at(file, names.saturating_add(entry_name), "name in a group")?;
                let name = text.terminated(MAX_NAME)?;
                LinkBudget::take(&mut budget.names, name.len() + 1)?;
                links.push((name, header));
            }
        } else {
            node.signature(b"TREE")?;
            node.bytes(2)?; // type, level
            let entries = node.u16()?;
            LinkBudget::take(&mut budget.nodes, 24 + 16 * usize::from(entries))?;
            node.bytes(16)?; // siblings
            for _ in 0..entries {
                node.u64()?; // first name
                waiting.push(node.u64()?);
            }
        }
    }
    Ok(())
}

/// A link message (section IV.A.2.g): name and target of a hard link.
fn hard_link(data: &[u8]) -> Result<Option<(&[u8], u64)>, FileProblem> {
    let mut fields = Fields::new(data, "link message");
    fields.one_of("link message version", &[1])?;
    let flags = fields.u8()?;
    let kind = if flags & 0x08 != 0 { fields.u8()? } else { 0 };
    fields.bytes(if flags & 0x04 != 0 { 8 } else { 0 })?; // creation order
    fields.bytes(if flags & 0x10 != 0 { 1 } else { 0 })?; // character set
    let length = fields.number(1 << (flags & 3))?;
    let name = fields.bytes(usize::try_from(length).unwrap_or(usize::MAX))?;
    if kind == 0 { Ok(Some((name, fields.u64()?))) } else { Ok(None) }
}
