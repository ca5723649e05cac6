#include "pool.h"

#include <cstdint>
#include <new>
#include <thread>
#include <vector>

#include "testing.h"

namespace pathfold::core {
namespace {

constexpr size_t mebibyte = 1 << 20;

} // namespace

TEST(Pool, WithoutOneItIsTheHeap) {
    for (size_t bytes : {size_t(0), size_t(1), size_t(100), mebibyte}) {
        auto *memory = static_cast<char *>(Pool::allocate(bytes));
        EXPECT_EQ(reinterpret_cast<uintptr_t>(memory) % 64, 0u);
        std::fill_n(memory, bytes, char(1));
        Pool::free(memory);
    }
    Pool::free(nullptr);
    EXPECT_THROW(Pool::allocate(SIZE_MAX), std::bad_alloc);
    EXPECT_THROW(Pool::allocate(SIZE_MAX - 100), std::bad_alloc);
}

TEST(Pool, BlocksAreUsedAgain) {
    Pool pool;
    const Pool::Use use(pool);
    void *first = Pool::allocate(mebibyte);
    EXPECT_EQ(reinterpret_cast<uintptr_t>(first) % 64, 0u);
    const int64_t held = pool.bytes();
    EXPECT_GE(held, int64_t(mebibyte));
    Pool::free(first);
    EXPECT_EQ(Pool::allocate(mebibyte * 3 / 4), first); // fits
    void *second = Pool::allocate(mebibyte / 4);
    EXPECT_GT(pool.bytes(), held);
    Pool::free(first);
    Pool::free(second);
    EXPECT_EQ(Pool::allocate(mebibyte / 4), second);
    void *small = Pool::allocate(mebibyte / 8); // the first is too large for it
    EXPECT_NE(small, first);
    Pool::free(second);
    Pool::free(small);
    pool.release();
    EXPECT_EQ(pool.bytes(), 0);
}

TEST(Pool, WhatAFrameHasNotUsedIsGivenBack) {
    Pool pool;
    const Pool::Use use(pool);
    const auto frame = [&](size_t bytes) {
        pool.start(INT64_MAX);
        void *memory = Pool::allocate(bytes);
        Pool::free(memory);
        pool.finish();
        return pool.bytes();
    };
    const int64_t large = frame(16 * mebibyte), small = frame(mebibyte);
    EXPECT_GE(large, int64_t(16 * mebibyte));
    EXPECT_GE(small, int64_t(mebibyte));
    EXPECT_LT(small, int64_t(2 * mebibyte));
    EXPECT_EQ(frame(mebibyte), small);
}

TEST(Pool, IsBounded) {
    Pool pool;
    const Pool::Use use(pool);
    pool.start(4 * mebibyte);
    void *first = Pool::allocate(mebibyte), *second = Pool::allocate(2 * mebibyte);
    EXPECT_FALSE(pool.refused());
    EXPECT_THROW(Pool::allocate(2 * mebibyte), std::bad_alloc);
    EXPECT_TRUE(pool.refused());
    EXPECT_THROW(Pool::allocate(SIZE_MAX - 10000), std::bad_alloc);
    Pool::free(first);
    Pool::free(second);
    Pool::free(Pool::allocate(3 * mebibyte)); // in the place of what is free
    EXPECT_LE(pool.bytes(), int64_t(4 * mebibyte));
    pool.start(64 * mebibyte);
    EXPECT_FALSE(pool.refused());
}

TEST(Pool, IsOfTheThreadThatUsesIt) {
    Pool pool, inner;
    const Pool::Use use(pool);
    void *memory = nullptr;
    std::thread([&] { memory = Pool::allocate(mebibyte); }).join();
    EXPECT_EQ(pool.bytes(), 0);
    Pool::free(memory);
    {
        const Pool::Use nested(inner);
        memory = Pool::allocate(mebibyte);
    }
    EXPECT_EQ(pool.bytes(), 0);
    std::thread([&] { Pool::free(memory); }).join(); // from any thread
    EXPECT_GT(inner.bytes(), 0);
    Pool::free(Pool::allocate(mebibyte));
    EXPECT_GT(pool.bytes(), 0);
}

} // namespace pathfold::core
