#include "pool.h"

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
    Pool *pool;     // null: of the heap
    size_t size;    // with this
    uint64_t frame; // that used it last
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
        block = new (memory) Block{nullptr, size, 0};
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

/// The smallest free block that is large enough, unless more than half of it would be wasted.
Pool::Block *Pool::take(size_t bytes) {
    const std::lock_guard<std::mutex> lock(mutex_);
    auto found = free_.lower_bound(bytes);
    if (found != free_.end() && found->first / 2 <= bytes) {
        Block *block = found->second;
        free_.erase(found);
        block->frame = frame_;
        return block;
    }
    const size_t size = (bytes + page - 1) / page * page;
    const auto fits = [&] { return bytes_ <= bound_ && size <= size_t(bound_ - bytes_); };
    while (!fits() && !free_.empty()) {
        unmap(free_.begin()->second);
        free_.erase(free_.begin());
    }
    refused_ = refused_ || !fits();
    void *memory =
        fits() ? mmap(nullptr, size, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0) : MAP_FAILED;
    if (memory == MAP_FAILED)
        throw std::bad_alloc();
    bytes_ += int64_t(size);
    return new (memory) Block{this, size, frame_};
}

void Pool::give_back(Block *block) {
    const std::lock_guard<std::mutex> lock(mutex_);
    free_.emplace(block->size, block);
}

void Pool::unmap(Block *block) {
    bytes_ -= int64_t(block->size);
    munmap(block, block->size);
}

void Pool::start(int64_t bound) {
    const std::lock_guard<std::mutex> lock(mutex_);
    bound_ = bound;
    refused_ = false;
    ++frame_;
}

void Pool::finish() {
    const std::lock_guard<std::mutex> lock(mutex_);
    for (auto at = free_.begin(); at != free_.end();) {
        Block *block = at->second;
        if (block->frame == frame_) {
            ++at;
            continue;
        }
        unmap(block);
        at = free_.erase(at);
    }
}

void Pool::release() {
    const std::lock_guard<std::mutex> lock(mutex_);
    for (const auto &[size, block] : free_)
        unmap(block);
    free_.clear();
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
