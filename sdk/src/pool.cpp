#include "pool.h"

#include <algorithm>
#include <cstdlib>
#include <new>

#include <sys/mman.h>

namespace pathfold::core {
namespace {

constexpr size_t alignment = 64, page = 4096;
constexpr size_t least_pooled = 64 * 1024; // bytes; the heap is as good at less

thread_local Pool *current = nullptr;

} // namespace

/// What lies before the memory that is handed out.
struct alignas(alignment) Pool::Block {
    Pool *pool;            // null: of the heap
    size_t size;           // with this
    uint64_t frame;        // that used it last
    Block *before, *after; // of the same region
    bool is_free;

    bool is_region() const { return before == nullptr && after == nullptr; }
};

void *Pool::allocate(size_t bytes) {
    if (bytes > SIZE_MAX - 2 * page)
        throw std::bad_alloc();
    const size_t size = bytes + sizeof(Block);
    Block *block = nullptr;
    if (current != nullptr && size >= least_pooled) {
        block = current->take(size);
    } else {
        void *memory = std::aligned_alloc(alignment, (size + alignment - 1) / alignment * alignment);
        if (memory == nullptr)
            throw std::bad_alloc();
        block = new (memory) Block{nullptr, size, 0, nullptr, nullptr, false};
    }
    return block + 1;
}

void Pool::free(void *memory) {
    if (memory == nullptr)
        return;
    Block *block = static_cast<Block *>(memory) - 1;
    if (block->pool != nullptr)
        block->pool->give_back(block);
    else
        std::free(block);
}

Pool::Block *Pool::take(size_t bytes) {
    const std::lock_guard<std::mutex> lock(mutex_);
    bytes = (bytes + alignment - 1) / alignment * alignment;
    const auto found = free_.lower_bound({bytes, nullptr}); // the smallest that is large enough
    Block *block = nullptr;
    if (found != free_.end()) {
        block = found->second;
        free_.erase(found);
    } else {
        block = map((bytes + page - 1) / page * page);
    }
    cut(block, bytes);
    block->is_free = false;
    block->frame = frame_;
    return block;
}

/// A new region.
Pool::Block *Pool::map(size_t bytes) {
    const auto fits = [&] { return bytes_ <= bound_ && bytes <= size_t(bound_ - bytes_); };
    if (!fits())
        unmap([](const Block &) { return true; });
    refused_ = refused_ || !fits();
    void *memory = fits() ? mmap(nullptr, bytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0)
                          : MAP_FAILED;
    if (memory == MAP_FAILED)
        throw std::bad_alloc();
    bytes_ += int64_t(bytes);
    return new (memory) Block{this, bytes, frame_, nullptr, nullptr, false};
}

/// Leaves what a block has beyond so many bytes as a free one, unless it is little.
void Pool::cut(Block *block, size_t bytes) {
    if (block->size - bytes < least_pooled)
        return;
    void *memory = reinterpret_cast<char *>(block) + bytes;
    Block *rest = new (memory) Block{this, block->size - bytes, block->frame, block, block->after, true};
    if (rest->after != nullptr)
        rest->after->before = rest;
    block->after = rest;
    block->size = bytes;
    free_.emplace(rest->size, rest);
}

/// Puts a block together with the one after it.
void Pool::join(Block *block, Block *after) {
    block->size += after->size;
    block->frame = std::max(block->frame, after->frame);
    block->after = after->after;
    if (block->after != nullptr)
        block->after->before = block;
}

void Pool::give_back(Block *block) {
    const std::lock_guard<std::mutex> lock(mutex_);
    block->is_free = true;
    if (Block *after = block->after; after != nullptr && after->is_free) {
        free_.erase({after->size, after});
        join(block, after);
    }
    if (Block *before = block->before; before != nullptr && before->is_free) {
        free_.erase({before->size, before});
        join(before, block);
        block = before;
    }
    free_.emplace(block->size, block);
}

/// Gives regions back that are free as a whole and pass the test.
template <typename Test>
void Pool::unmap(const Test &test) {
    for (auto at = free_.begin(); at != free_.end();) {
        Block *block = at->second;
        if (!block->is_region() || !test(*block)) {
            ++at;
            continue;
        }
        at = free_.erase(at);
        bytes_ -= int64_t(block->size);
        munmap(block, block->size);
    }
}

void Pool::start(int64_t bound) {
    const std::lock_guard<std::mutex> lock(mutex_);
    bound_ = bound;
    refused_ = false;
    ++frame_;
}

void Pool::finish() {
    const std::lock_guard<std::mutex> lock(mutex_);
    unmap([&](const Block &block) { return block.frame != frame_; });
}

void Pool::release() {
    const std::lock_guard<std::mutex> lock(mutex_);
    unmap([](const Block &) { return true; });
}

int64_t Pool::bytes() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return bytes_;
}

bool Pool::refused() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return refused_;
}

Pool::Use::Use(Pool &pool) : before_(current) { current = &pool; }

Pool::Use::~Use() { current = before_; }

} // namespace pathfold::core
