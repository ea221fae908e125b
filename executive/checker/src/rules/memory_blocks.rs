//! Rules about memory blocks: who shares them, and what is in them.

use std::collections::HashMap;

use super::Context;
use crate::catalogue;
use crate::findings::Finding;
use crate::raw::RawMemoryBlock;
use crate::reader::At;
use crate::units::ShowSize;
use bateleur_plan::MemoryBlock;
use bateleur_plan::bounds::LARGEST_BLOCK;

pub(super) fn check(cx: &Context<'_>) {
    for (block, planned) in cx.file.memory_blocks.iter().zip(&cx.plan.memory_blocks) {
        size(cx, block);
        given(cx, block);
        once(cx, block);
        on_one_module(cx, block, planned);
        written(cx, block);
        content(cx, block);
    }
}

fn size(cx: &Context<'_>, block: &RawMemoryBlock) {
    let Some(size) = block.size.said().filter(|size| !(1..=LARGEST_BLOCK).contains(&size.value.0)) else {
        return;
    };
    let message = format!("memory block `{}` has {}", block.name.value, ShowSize(size.value.0));
    let mend = format!("give it 1B to {}", ShowSize(LARGEST_BLOCK));
    cx.note(&catalogue::OUT_OF_RANGE, &size.span, message, mend);
}

fn given(cx: &Context<'_>, block: &RawMemoryBlock) {
    let lists = [&block.read, &block.read_write];
    if lists.iter().all(|list| list.is_absent() || list.said().is_some_and(|list| list.value.is_empty())) {
        let message = format!("memory block `{}` is given to nobody", block.name.value);
        let mend = "name partitions in `read` or `read_write`";
        cx.note(&catalogue::BLOCK_OF_NOBODY, &block.name.span, message, mend);
    }
}

fn once(cx: &Context<'_>, block: &RawMemoryBlock) {
    let mut seen: HashMap<&str, &At<String>> = HashMap::new();
    for partition in block.partitions() {
        let Some(first) = seen.insert(&partition.value, partition) else { continue };
        let message = format!("memory block `{}` is given to `{}` twice", block.name.value, partition.value);
        let mend = "name it once: in `read_write` if it writes, else in `read`";
        let finding = Finding::new(&catalogue::BLOCK_TWICE, &partition.span, message, mend);
        cx.add(finding.also(&first.span, "it is named here before"));
    }
}

fn on_one_module(cx: &Context<'_>, block: &RawMemoryBlock, planned: &MemoryBlock) {
    let all = block.partitions().zip(planned.partitions());
    let mut all = all.filter_map(|(name, partition)| Some((name, cx.module_of(partition)?)));
    let Some((first, home)) = all.next() else { return };
    for (partition, other) in all.filter(|(_, other)| *other != home) {
        let message = format!(
            "memory block `{}` is shared by `{}` on `{}` and `{}` on `{}`",
            block.name.value,
            first.value,
            cx.module_name(home),
            partition.value,
            cx.module_name(other)
        );
        let mend = "share it on one module, and send what the other one needs through a port";
        let finding = Finding::new(&catalogue::BLOCK_ON_TWO_MODULES, &partition.span, message, mend);
        cx.add(finding.also(&first.span, format!("`{}` runs on `{}`", first.value, cx.module_name(home))));
    }
}

fn written(cx: &Context<'_>, block: &RawMemoryBlock) {
    // A list that could not be read may name somebody.
    let is_written = !block.read_write.items().is_empty()
        || !(block.read_write.is_absent() || block.read_write.said().is_some());
    if !block.read.items().is_empty() && !is_written && block.content.is_absent() {
        let message = format!("nobody writes memory block `{}`, and it has no content", block.name.value);
        let mend = "name a partition in `read_write`, or a file in `content`";
        cx.note(&catalogue::BLOCK_NEVER_WRITTEN, &block.name.span, message, mend);
    }
}

fn content(cx: &Context<'_>, block: &RawMemoryBlock) {
    let (Some(contents), Some(content)) = (cx.contents, block.content.said()) else { return };
    // What is wrong with the size is said elsewhere.
    let size = block.size.said().map_or(u64::MAX, |size| size.value.0);
    if let Some(fault) = contents.fault(&content.value, size) {
        let message =
            format!("the content of memory block `{}`, `{}`: {fault}", block.name.value, content.value);
        let mend = "put the file there, relative to this one, no longer than the block's `size`; without `content` the block holds zeros";
        cx.note(&catalogue::BLOCK_CONTENT, &content.span, message, mend);
    }
}
