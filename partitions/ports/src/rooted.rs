//! The service variant below every channel: all that the library makes for it is a file below the channel's directory.
//!
//! The library's own variant puts segments and connections into `/dev/shm`, where names are machine-wide: one process
//! that may use one of them may use all. As files they are kept apart by directories, which can be hidden. It must
//! never take a mechanism whose names are not paths.

use std::fmt::Debug;

use iceoryx2::prelude::ZeroCopySend;
use iceoryx2::service::Service;
use iceoryx2::service::internal::ServiceInternal;
use iceoryx2::unique_id_generator::unique_system_id::UniqueSystemId;
use iceoryx2_bb_elementary_traits::testing::abandonable::Abandonable;
use iceoryx2_cal::arc_sync_policy::single_threaded::SingleThreaded;
use iceoryx2_cal::resizable_shared_memory::dynamic::DynamicMemory;
use iceoryx2_cal::shm_allocator::{bump_allocator::BumpAllocator, pool_allocator::PoolAllocator};
use iceoryx2_cal::{
    bag, dynamic_storage, event, hash, monitoring, reactor, serialize, shared_memory, static_storage,
    zero_copy_connection,
};

/// A segment that messages lie in.
type Segment = shared_memory::file::Memory<PoolAllocator>;

/// See the module's head.
#[derive(Debug, Clone)]
pub struct Rooted {}

impl Service for Rooted {
    type StaticStorage = static_storage::recommended::Ipc;
    type ConfigSerializer = serialize::recommended::Recommended;
    type PersistentDynamicStorage<T: Debug + Send + Sync + ZeroCopySend + 'static> =
        dynamic_storage::file::Storage<T>;
    type Bag = bag::recommended::Recommended;
    type DynamicStorage<T: Debug + Send + Sync + ZeroCopySend + 'static> = dynamic_storage::file::Storage<T>;
    type ServiceNameHasher = hash::recommended::Recommended;
    type SharedMemory = Segment;
    type ResizableSharedMemory = DynamicMemory<PoolAllocator, Segment>;
    type Connection = zero_copy_connection::file::Connection;
    // Neither events nor blackboards are used; an event's socket is a path too.
    type Event = event::recommended::Ipc;
    type Monitoring = monitoring::recommended::Ipc;
    type Reactor = reactor::recommended::Ipc;
    type ArcThreadSafetyPolicy<T: Send + Debug + Abandonable> = SingleThreaded<T>;
    type BlackboardMgmt<T: Send + Sync + Debug + ZeroCopySend + 'static> = dynamic_storage::file::Storage<T>;
    type BlackboardPayload = shared_memory::file::Memory<BumpAllocator>;
    type UniqueId = UniqueSystemId;
}

impl ServiceInternal<Rooted> for Rooted {}
