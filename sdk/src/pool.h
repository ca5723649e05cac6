#pragma once

#include <cstddef>
#include <cstdint>
#include <mutex>
#include <set>
#include <utility>

namespace pathfold::core {

/// The memory that networks work in, of one denoiser: blocks that are used again for what fits them, and
/// given back when a frame has not used them. Freed in any order, but before the pool.
class Pool {
public:
    Pool() = default;
    ~Pool() { release(); }
    Pool(const Pool &) = delete;

    /// Starts a frame, of whose networks none may hold more than `bound` bytes at once.
    void start(int64_t bound);

    /// Ends it: what it did not use is given back.
    void finish();

    /// Gives everything back that is not in use.
    void release();

    int64_t bytes() const; ///< that are held
    bool refused() const;  ///< whether something did not fit the bound since the frame's start

    /// Takes what onnxruntime allocates on this thread, for as long as it lives.
    class Use {
    public:
        explicit Use(Pool &pool);
        ~Use();
        Use(const Use &) = delete;

    private:
        Pool *before_;
    };

    /// Memory of the pool in use on this thread, or of the heap where there is none or little is asked for.
    /// Aligned to 64 bytes. Throws std::bad_alloc.
    static void *allocate(size_t bytes);
    static void free(void *memory);

private:
    struct Block;

    using Blocks = std::set<std::pair<size_t, Block *>>; // by their sizes

    Block *take(size_t bytes);
    Block *map(size_t bytes);
    void cut(Block *block, size_t bytes);
    void join(Block *block, Block *after);
    void give_back(Block *block);
    template <typename Test>
    void unmap(const Test &test);

    mutable std::mutex mutex_;
    Blocks free_;
    int64_t bytes_ = 0, bound_ = INT64_MAX;
    uint64_t frame_ = 0;
    bool refused_ = false;
};

} // namespace pathfold::core
