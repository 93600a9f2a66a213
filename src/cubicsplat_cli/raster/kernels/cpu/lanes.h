// 16 floats as one value, for the CPU: AVX-512, AVX2, NEON or portable loops, chosen by how the file is compiled.
// Numbers of edges are kept as floats (exact below 2^24), so one type is enough.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>

#include "../shared/pixel.h"

#if defined(__AVX512F__) || defined(__AVX2__)
#include <immintrin.h>
#elif defined(CS_NEON)
#include <arm_neon.h>
#endif

namespace cs {
namespace CS_ISA {

constexpr int kLanes = 16;

// Every kind of Lanes has, beside its operations:
// load_pixels<C>(rows, planes): four rows of four pixels, C values each, as one vector for each of the C.
// having_bit(words, bit): which of sixteen words have the bit.

// The sums of four vectors, in their order.
struct Four {
  float v[4];
};

#if defined(__AVX512F__)

struct Mask {
  __mmask16 m;
};
struct Lanes {
  __m512 v;
  Lanes() = default;
  CS_INLINE Lanes(__m512 x) : v(x) {}
  CS_INLINE explicit Lanes(float x) : v(_mm512_set1_ps(x)) {}
  CS_INLINE static Lanes load(const float* p) { return _mm512_loadu_ps(p); }
  CS_INLINE void store(float* p) const { _mm512_storeu_ps(p, v); }
};
CS_INLINE Lanes operator+(Lanes a, Lanes b) { return _mm512_add_ps(a.v, b.v); }
CS_INLINE Lanes operator-(Lanes a, Lanes b) { return _mm512_sub_ps(a.v, b.v); }
CS_INLINE Lanes operator*(Lanes a, Lanes b) { return _mm512_mul_ps(a.v, b.v); }
CS_INLINE Lanes operator/(Lanes a, Lanes b) { return _mm512_div_ps(a.v, b.v); }
CS_INLINE Lanes fused(Lanes a, Lanes b, Lanes c) { return _mm512_fmadd_ps(a.v, b.v, c.v); }
CS_INLINE Lanes minimum(Lanes a, Lanes b) { return _mm512_min_ps(a.v, b.v); }
CS_INLINE Lanes maximum(Lanes a, Lanes b) { return _mm512_max_ps(a.v, b.v); }
CS_INLINE Lanes absolute(Lanes a) { return _mm512_abs_ps(a.v); }
CS_INLINE Lanes square_root(Lanes a) { return _mm512_sqrt_ps(a.v); }
CS_INLINE Mask operator<(Lanes a, Lanes b) { return {_mm512_cmp_ps_mask(a.v, b.v, _CMP_LT_OQ)}; }
CS_INLINE Mask operator>(Lanes a, Lanes b) { return {_mm512_cmp_ps_mask(a.v, b.v, _CMP_GT_OQ)}; }
CS_INLINE Mask operator<=(Lanes a, Lanes b) { return {_mm512_cmp_ps_mask(a.v, b.v, _CMP_LE_OQ)}; }
CS_INLINE Mask operator>=(Lanes a, Lanes b) { return {_mm512_cmp_ps_mask(a.v, b.v, _CMP_GE_OQ)}; }
CS_INLINE Mask operator==(Lanes a, Lanes b) { return {_mm512_cmp_ps_mask(a.v, b.v, _CMP_EQ_OQ)}; }
CS_INLINE Mask operator!=(Lanes a, Lanes b) { return {_mm512_cmp_ps_mask(a.v, b.v, _CMP_NEQ_OQ)}; }
CS_INLINE Mask operator&(Mask a, Mask b) { return {__mmask16(a.m & b.m)}; }
CS_INLINE Mask operator|(Mask a, Mask b) { return {__mmask16(a.m | b.m)}; }
CS_INLINE Mask without(Mask a, Mask b) { return {__mmask16(a.m & ~b.m)}; }
CS_INLINE Lanes select(Mask m, Lanes a, Lanes b) { return _mm512_mask_blend_ps(m.m, b.v, a.v); }
CS_INLINE Lanes add_where(Mask m, Lanes a, Lanes b) { return _mm512_mask_add_ps(a.v, m.m, a.v, b.v); }
CS_INLINE unsigned bits(Mask m) { return m.m; }
CS_INLINE unsigned having_bit(const uint16_t* words, int bit) {
  const __m256i w = _mm256_loadu_si256(reinterpret_cast<const __m256i*>(words));
  return _mm256_test_epi16_mask(w, _mm256_set1_epi16(short(1 << bit)));
}
CS_INLINE float first(Lanes a) { return _mm512_cvtss_f32(a.v); }
CS_INLINE float sum(Lanes a) { return _mm512_reduce_add_ps(a.v); }
CS_INLINE Lanes repeat_each(float a, float b, float c, float d) {
  const __m512i index = _mm512_set_epi32(3, 3, 3, 3, 2, 2, 2, 2, 1, 1, 1, 1, 0, 0, 0, 0);
  return _mm512_permutexvar_ps(index, _mm512_castps128_ps512(_mm_setr_ps(a, b, c, d)));
}
template <int C>
CS_INLINE void load_pixels(const float* const* rows, Lanes* planes) {
  const __mmask16 row = __mmask16((1u << (4 * C)) - 1u);
  __m512 r[4];
  for (int i = 0; i < 4; i++) r[i] = _mm512_maskz_loadu_ps(row, rows[i]);
  for (int c = 0; c < C; c++) {
    const __m512i from = _mm512_add_epi32(
        _mm512_setr_epi32(0, C, 2 * C, 3 * C, 16, 16 + C, 16 + 2 * C, 16 + 3 * C, 0, 0, 0, 0, 0, 0, 0, 0),
        _mm512_set1_epi32(c));
    const __m512 upper = _mm512_permutex2var_ps(r[0], from, r[1]), lower = _mm512_permutex2var_ps(r[2], from, r[3]);
    planes[c] = _mm512_insertf32x8(upper, _mm512_castps512_ps256(lower), 1);
  }
}
CS_INLINE Four sum_of_four(Lanes a, Lanes b, Lanes c, Lanes d) {
  __m512 ab = _mm512_add_ps(_mm512_unpacklo_ps(a.v, b.v), _mm512_unpackhi_ps(a.v, b.v));
  __m512 cd = _mm512_add_ps(_mm512_unpacklo_ps(c.v, d.v), _mm512_unpackhi_ps(c.v, d.v));
  __m512 s = _mm512_add_ps(_mm512_shuffle_ps(ab, cd, 0x44), _mm512_shuffle_ps(ab, cd, 0xee));
  __m256 h = _mm256_add_ps(_mm512_castps512_ps256(s), _mm512_extractf32x8_ps(s, 1));
  Four r;
  _mm_storeu_ps(r.v, _mm_add_ps(_mm256_castps256_ps128(h), _mm256_extractf128_ps(h, 1)));
  return r;
}

#elif defined(__AVX2__)

struct Mask {
  __m256 a, b;
};
struct Lanes {
  __m256 a, b;
  Lanes() = default;
  CS_INLINE Lanes(__m256 x, __m256 y) : a(x), b(y) {}
  CS_INLINE explicit Lanes(float x) : a(_mm256_set1_ps(x)), b(a) {}
  CS_INLINE static Lanes load(const float* p) { return {_mm256_loadu_ps(p), _mm256_loadu_ps(p + 8)}; }
  CS_INLINE void store(float* p) const {
    _mm256_storeu_ps(p, a);
    _mm256_storeu_ps(p + 8, b);
  }
};
CS_INLINE Lanes operator+(Lanes x, Lanes y) { return {_mm256_add_ps(x.a, y.a), _mm256_add_ps(x.b, y.b)}; }
CS_INLINE Lanes operator-(Lanes x, Lanes y) { return {_mm256_sub_ps(x.a, y.a), _mm256_sub_ps(x.b, y.b)}; }
CS_INLINE Lanes operator*(Lanes x, Lanes y) { return {_mm256_mul_ps(x.a, y.a), _mm256_mul_ps(x.b, y.b)}; }
CS_INLINE Lanes operator/(Lanes x, Lanes y) { return {_mm256_div_ps(x.a, y.a), _mm256_div_ps(x.b, y.b)}; }
CS_INLINE Lanes fused(Lanes x, Lanes y, Lanes z) {
  return {_mm256_fmadd_ps(x.a, y.a, z.a), _mm256_fmadd_ps(x.b, y.b, z.b)};
}
CS_INLINE Lanes minimum(Lanes x, Lanes y) { return {_mm256_min_ps(x.a, y.a), _mm256_min_ps(x.b, y.b)}; }
CS_INLINE Lanes maximum(Lanes x, Lanes y) { return {_mm256_max_ps(x.a, y.a), _mm256_max_ps(x.b, y.b)}; }
CS_INLINE Lanes absolute(Lanes x) {
  const __m256 sign = _mm256_set1_ps(-0.0f);
  return {_mm256_andnot_ps(sign, x.a), _mm256_andnot_ps(sign, x.b)};
}
CS_INLINE Lanes square_root(Lanes x) { return {_mm256_sqrt_ps(x.a), _mm256_sqrt_ps(x.b)}; }
#define CS_COMPARE(op, code)                                               \
  CS_INLINE Mask operator op(Lanes x, Lanes y) {                           \
    return {_mm256_cmp_ps(x.a, y.a, code), _mm256_cmp_ps(x.b, y.b, code)}; \
  }
CS_COMPARE(<, _CMP_LT_OQ)
CS_COMPARE(>, _CMP_GT_OQ)
CS_COMPARE(<=, _CMP_LE_OQ)
CS_COMPARE(>=, _CMP_GE_OQ)
CS_COMPARE(==, _CMP_EQ_OQ)
CS_COMPARE(!=, _CMP_NEQ_OQ)
#undef CS_COMPARE
CS_INLINE Mask operator&(Mask x, Mask y) { return {_mm256_and_ps(x.a, y.a), _mm256_and_ps(x.b, y.b)}; }
CS_INLINE Mask operator|(Mask x, Mask y) { return {_mm256_or_ps(x.a, y.a), _mm256_or_ps(x.b, y.b)}; }
CS_INLINE Mask without(Mask x, Mask y) { return {_mm256_andnot_ps(y.a, x.a), _mm256_andnot_ps(y.b, x.b)}; }
CS_INLINE Lanes select(Mask m, Lanes x, Lanes y) {
  return {_mm256_blendv_ps(y.a, x.a, m.a), _mm256_blendv_ps(y.b, x.b, m.b)};
}
CS_INLINE Lanes add_where(Mask m, Lanes x, Lanes y) {
  return {_mm256_add_ps(x.a, _mm256_and_ps(m.a, y.a)), _mm256_add_ps(x.b, _mm256_and_ps(m.b, y.b))};
}
CS_INLINE unsigned having_bit(const uint16_t* words, int bit) {
  const __m256i w = _mm256_loadu_si256(reinterpret_cast<const __m256i*>(words)), b = _mm256_set1_epi16(short(1 << bit));
  const __m256i found = _mm256_cmpeq_epi16(_mm256_and_si256(w, b), b);
  const __m128i bytes = _mm_packs_epi16(_mm256_castsi256_si128(found), _mm256_extracti128_si256(found, 1));
  return unsigned(_mm_movemask_epi8(bytes));
}
CS_INLINE unsigned bits(Mask m) { return unsigned(_mm256_movemask_ps(m.a)) | (unsigned(_mm256_movemask_ps(m.b)) << 8); }
CS_INLINE float first(Lanes x) { return _mm256_cvtss_f32(x.a); }
CS_INLINE float sum(Lanes x) {
  __m256 s = _mm256_add_ps(x.a, x.b);
  __m128 q = _mm_add_ps(_mm256_castps256_ps128(s), _mm256_extractf128_ps(s, 1));
  q = _mm_add_ps(q, _mm_movehl_ps(q, q));
  return _mm_cvtss_f32(_mm_add_ss(q, _mm_shuffle_ps(q, q, 1)));
}
CS_INLINE Lanes repeat_each(float a, float b, float c, float d) {
  return {_mm256_setr_m128(_mm_set1_ps(a), _mm_set1_ps(b)), _mm256_setr_m128(_mm_set1_ps(c), _mm_set1_ps(d))};
}
CS_INLINE void load_row(const float* p, __m128 (&planes)[3]) {
  const __m128 a = _mm_loadu_ps(p), b = _mm_loadu_ps(p + 4), c = _mm_loadu_ps(p + 8);
  planes[0] = _mm_shuffle_ps(a, _mm_shuffle_ps(b, c, _MM_SHUFFLE(1, 1, 2, 2)), _MM_SHUFFLE(2, 0, 3, 0));
  planes[1] = _mm_shuffle_ps(_mm_shuffle_ps(a, b, _MM_SHUFFLE(0, 0, 1, 1)),
                             _mm_shuffle_ps(b, c, _MM_SHUFFLE(2, 2, 3, 3)), _MM_SHUFFLE(2, 0, 2, 0));
  planes[2] = _mm_shuffle_ps(_mm_shuffle_ps(a, b, _MM_SHUFFLE(1, 1, 2, 2)), c, _MM_SHUFFLE(3, 0, 2, 0));
}
CS_INLINE void load_row(const float* p, __m128 (&planes)[4]) {
  for (int i = 0; i < 4; i++) planes[i] = _mm_loadu_ps(p + 4 * i);
  _MM_TRANSPOSE4_PS(planes[0], planes[1], planes[2], planes[3]);
}
template <int C>
CS_INLINE void load_pixels(const float* const* rows, Lanes* planes) {
  __m128 r[4][C];
  for (int i = 0; i < 4; i++) load_row(rows[i], r[i]);
  for (int c = 0; c < C; c++) planes[c] = {_mm256_setr_m128(r[0][c], r[1][c]), _mm256_setr_m128(r[2][c], r[3][c])};
}
CS_INLINE Four sum_of_four(Lanes x, Lanes y, Lanes z, Lanes w) {
  __m256 a = _mm256_add_ps(x.a, x.b), b = _mm256_add_ps(y.a, y.b), c = _mm256_add_ps(z.a, z.b),
         d = _mm256_add_ps(w.a, w.b);
  __m256 ab = _mm256_add_ps(_mm256_unpacklo_ps(a, b), _mm256_unpackhi_ps(a, b));
  __m256 cd = _mm256_add_ps(_mm256_unpacklo_ps(c, d), _mm256_unpackhi_ps(c, d));
  __m256 s = _mm256_add_ps(_mm256_shuffle_ps(ab, cd, 0x44), _mm256_shuffle_ps(ab, cd, 0xee));
  Four r;
  _mm_storeu_ps(r.v, _mm_add_ps(_mm256_castps256_ps128(s), _mm256_extractf128_ps(s, 1)));
  return r;
}

#elif defined(CS_NEON)

struct Mask {
  uint32x4_t m[4];
};
struct Lanes {
  float32x4_t v[4];
  Lanes() = default;
  CS_INLINE Lanes(float32x4_t a, float32x4_t b, float32x4_t c, float32x4_t d) : v{a, b, c, d} {}
  CS_INLINE explicit Lanes(float x) : v{vdupq_n_f32(x), vdupq_n_f32(x), vdupq_n_f32(x), vdupq_n_f32(x)} {}
  CS_INLINE static Lanes load(const float* p) {
    return {vld1q_f32(p), vld1q_f32(p + 4), vld1q_f32(p + 8), vld1q_f32(p + 12)};
  }
  CS_INLINE void store(float* p) const {
    for (int i = 0; i < 4; i++) vst1q_f32(p + 4 * i, v[i]);
  }
};
// One instruction for each quarter.
#define CS_QUARTERS(Result, field, expression)           \
  Result r;                                              \
  for (int i = 0; i < 4; i++) r.field[i] = (expression); \
  return r
CS_INLINE Lanes operator+(Lanes a, Lanes b) { CS_QUARTERS(Lanes, v, vaddq_f32(a.v[i], b.v[i])); }
CS_INLINE Lanes operator-(Lanes a, Lanes b) { CS_QUARTERS(Lanes, v, vsubq_f32(a.v[i], b.v[i])); }
CS_INLINE Lanes operator*(Lanes a, Lanes b) { CS_QUARTERS(Lanes, v, vmulq_f32(a.v[i], b.v[i])); }
CS_INLINE Lanes operator/(Lanes a, Lanes b) { CS_QUARTERS(Lanes, v, vdivq_f32(a.v[i], b.v[i])); }
CS_INLINE Lanes fused(Lanes a, Lanes b, Lanes c) { CS_QUARTERS(Lanes, v, vfmaq_f32(c.v[i], a.v[i], b.v[i])); }
CS_INLINE Lanes minimum(Lanes a, Lanes b) { CS_QUARTERS(Lanes, v, vminq_f32(a.v[i], b.v[i])); }
CS_INLINE Lanes maximum(Lanes a, Lanes b) { CS_QUARTERS(Lanes, v, vmaxq_f32(a.v[i], b.v[i])); }
CS_INLINE Lanes absolute(Lanes a) { CS_QUARTERS(Lanes, v, vabsq_f32(a.v[i])); }
CS_INLINE Lanes square_root(Lanes a) { CS_QUARTERS(Lanes, v, vsqrtq_f32(a.v[i])); }
CS_INLINE Mask operator<(Lanes a, Lanes b) { CS_QUARTERS(Mask, m, vcltq_f32(a.v[i], b.v[i])); }
CS_INLINE Mask operator>(Lanes a, Lanes b) { CS_QUARTERS(Mask, m, vcgtq_f32(a.v[i], b.v[i])); }
CS_INLINE Mask operator<=(Lanes a, Lanes b) { CS_QUARTERS(Mask, m, vcleq_f32(a.v[i], b.v[i])); }
CS_INLINE Mask operator>=(Lanes a, Lanes b) { CS_QUARTERS(Mask, m, vcgeq_f32(a.v[i], b.v[i])); }
CS_INLINE Mask operator==(Lanes a, Lanes b) { CS_QUARTERS(Mask, m, vceqq_f32(a.v[i], b.v[i])); }
CS_INLINE Mask operator!=(Lanes a, Lanes b) { CS_QUARTERS(Mask, m, vmvnq_u32(vceqq_f32(a.v[i], b.v[i]))); }
CS_INLINE Mask operator&(Mask a, Mask b) { CS_QUARTERS(Mask, m, vandq_u32(a.m[i], b.m[i])); }
CS_INLINE Mask operator|(Mask a, Mask b) { CS_QUARTERS(Mask, m, vorrq_u32(a.m[i], b.m[i])); }
CS_INLINE Mask without(Mask a, Mask b) { CS_QUARTERS(Mask, m, vbicq_u32(a.m[i], b.m[i])); }
CS_INLINE Lanes select(Mask m, Lanes a, Lanes b) { CS_QUARTERS(Lanes, v, vbslq_f32(m.m[i], a.v[i], b.v[i])); }
#undef CS_QUARTERS
CS_INLINE Lanes add_where(Mask m, Lanes a, Lanes b) { return select(m, a + b, a); }
CS_INLINE unsigned having_bit(const uint16_t* words, int bit) {
  static const uint16_t places[8] = {1, 2, 4, 8, 16, 32, 64, 128};
  const uint16x8_t wanted = vdupq_n_u16(uint16_t(1u << bit)), place = vld1q_u16(places);
  const unsigned low = vaddvq_u16(vandq_u16(vtstq_u16(vld1q_u16(words), wanted), place));
  return low | unsigned(vaddvq_u16(vandq_u16(vtstq_u16(vld1q_u16(words + 8), wanted), place))) << 8;
}
CS_INLINE unsigned bits(Mask m) {
  static const uint32_t places[4] = {1, 2, 4, 8};
  uint32x4_t place = vld1q_u32(places), all = vandq_u32(m.m[0], place);
  for (int i = 1; i < 4; i++) {
    place = vshlq_n_u32(place, 4);
    all = vorrq_u32(all, vandq_u32(m.m[i], place));
  }
  return vaddvq_u32(all);
}
CS_INLINE float first(Lanes a) { return vgetq_lane_f32(a.v[0], 0); }
CS_INLINE float32x4_t sum_of_quarters(Lanes a) {
  return vaddq_f32(vaddq_f32(a.v[0], a.v[1]), vaddq_f32(a.v[2], a.v[3]));
}
CS_INLINE float sum(Lanes a) { return vaddvq_f32(sum_of_quarters(a)); }
CS_INLINE Lanes repeat_each(float a, float b, float c, float d) {
  return {vdupq_n_f32(a), vdupq_n_f32(b), vdupq_n_f32(c), vdupq_n_f32(d)};
}
CS_INLINE void load_row(const float* p, int row, Lanes (&planes)[3]) {
  const float32x4x3_t r = vld3q_f32(p);
  for (int c = 0; c < 3; c++) planes[c].v[row] = r.val[c];
}
CS_INLINE void load_row(const float* p, int row, Lanes (&planes)[4]) {
  const float32x4x4_t r = vld4q_f32(p);
  for (int c = 0; c < 4; c++) planes[c].v[row] = r.val[c];
}
template <int C>
CS_INLINE void load_pixels(const float* const* rows, Lanes* planes) {
  Lanes loaded[C];
  for (int i = 0; i < 4; i++) load_row(rows[i], i, loaded);
  for (int c = 0; c < C; c++) planes[c] = loaded[c];
}
CS_INLINE Four sum_of_four(Lanes a, Lanes b, Lanes c, Lanes d) {
  const float32x4_t ab = vpaddq_f32(sum_of_quarters(a), sum_of_quarters(b));
  Four r;
  vst1q_f32(r.v, vpaddq_f32(ab, vpaddq_f32(sum_of_quarters(c), sum_of_quarters(d))));
  return r;
}

#else  // portable: plain loops, which compilers turn into the vectors of their target

struct Mask {
  bool m[kLanes];
};
struct Lanes {
  float v[kLanes];
  Lanes() = default;
  CS_INLINE explicit Lanes(float x) {
    for (int i = 0; i < kLanes; i++) v[i] = x;
  }
  CS_INLINE static Lanes load(const float* p) {
    Lanes r;
    for (int i = 0; i < kLanes; i++) r.v[i] = p[i];
    return r;
  }
  CS_INLINE void store(float* p) const {
    for (int i = 0; i < kLanes; i++) p[i] = v[i];
  }
};
#define CS_EACH(Result, expression)                           \
  Result r;                                                   \
  for (int i = 0; i < kLanes; i++) r CS_FIELD = (expression); \
  return r
#define CS_FIELD .v[i]
CS_INLINE Lanes operator+(const Lanes& a, const Lanes& b) { CS_EACH(Lanes, a.v[i] + b.v[i]); }
CS_INLINE Lanes operator-(const Lanes& a, const Lanes& b) { CS_EACH(Lanes, a.v[i] - b.v[i]); }
CS_INLINE Lanes operator*(const Lanes& a, const Lanes& b) { CS_EACH(Lanes, a.v[i] * b.v[i]); }
CS_INLINE Lanes operator/(const Lanes& a, const Lanes& b) { CS_EACH(Lanes, a.v[i] / b.v[i]); }
CS_INLINE Lanes fused(const Lanes& a, const Lanes& b, const Lanes& c) { CS_EACH(Lanes, a.v[i] * b.v[i] + c.v[i]); }
CS_INLINE Lanes minimum(const Lanes& a, const Lanes& b) { CS_EACH(Lanes, a.v[i] < b.v[i] ? a.v[i] : b.v[i]); }
CS_INLINE Lanes maximum(const Lanes& a, const Lanes& b) { CS_EACH(Lanes, a.v[i] > b.v[i] ? a.v[i] : b.v[i]); }
CS_INLINE Lanes absolute(const Lanes& a) { CS_EACH(Lanes, std::fabs(a.v[i])); }
CS_INLINE Lanes square_root(const Lanes& a) { CS_EACH(Lanes, std::sqrt(a.v[i])); }
CS_INLINE Lanes select(const Mask& m, const Lanes& a, const Lanes& b) { CS_EACH(Lanes, m.m[i] ? a.v[i] : b.v[i]); }
#undef CS_FIELD
#define CS_FIELD .m[i]
CS_INLINE Mask operator<(const Lanes& a, const Lanes& b) { CS_EACH(Mask, a.v[i] < b.v[i]); }
CS_INLINE Mask operator>(const Lanes& a, const Lanes& b) { CS_EACH(Mask, a.v[i] > b.v[i]); }
CS_INLINE Mask operator<=(const Lanes& a, const Lanes& b) { CS_EACH(Mask, a.v[i] <= b.v[i]); }
CS_INLINE Mask operator>=(const Lanes& a, const Lanes& b) { CS_EACH(Mask, a.v[i] >= b.v[i]); }
CS_INLINE Mask operator==(const Lanes& a, const Lanes& b) { CS_EACH(Mask, a.v[i] == b.v[i]); }
CS_INLINE Mask operator!=(const Lanes& a, const Lanes& b) { CS_EACH(Mask, a.v[i] != b.v[i]); }
CS_INLINE Mask operator&(const Mask& a, const Mask& b) { CS_EACH(Mask, a.m[i] && b.m[i]); }
CS_INLINE Mask operator|(const Mask& a, const Mask& b) { CS_EACH(Mask, a.m[i] || b.m[i]); }
CS_INLINE Mask without(const Mask& a, const Mask& b) { CS_EACH(Mask, a.m[i] && !b.m[i]); }
#undef CS_FIELD
#undef CS_EACH
CS_INLINE Lanes add_where(const Mask& m, const Lanes& a, const Lanes& b) { return select(m, a + b, a); }
CS_INLINE unsigned having_bit(const uint16_t* words, int bit) {
  unsigned r = 0;
  for (int i = 0; i < kLanes; i++) r |= unsigned(words[i] >> bit & 1) << i;
  return r;
}
CS_INLINE unsigned bits(const Mask& m) {
  unsigned r = 0;
  for (int i = 0; i < kLanes; i++) r |= unsigned(m.m[i]) << i;
  return r;
}
CS_INLINE float first(const Lanes& a) { return a.v[0]; }
CS_INLINE float sum(const Lanes& a) {
  float s = 0.0f;
  for (int i = 0; i < kLanes; i++) s += a.v[i];
  return s;
}
CS_INLINE Lanes repeat_each(float a, float b, float c, float d) {
  const float four[4] = {a, b, c, d};
  Lanes r;
  for (int i = 0; i < kLanes; i++) r.v[i] = four[i / 4];
  return r;
}
template <int C>
CS_INLINE void load_pixels(const float* const* rows, Lanes* planes) {
  for (int i = 0; i < kLanes; i++)
    for (int c = 0; c < C; c++) planes[c].v[i] = rows[i / 4][i % 4 * C + c];
}
CS_INLINE Four sum_of_four(const Lanes& a, const Lanes& b, const Lanes& c, const Lanes& d) {
  return {{sum(a), sum(b), sum(c), sum(d)}};
}

#endif

CS_INLINE bool any(const Mask& m) { return bits(m) != 0; }

// 0, 1, ... 15
CS_INLINE Lanes lane_numbers() {
  static const float numbers[kLanes] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
  return Lanes::load(numbers);
}

// Centres of a block of 4 x 4 pixels, from its corner: lane i is the pixel in column i % 4 of row i / 4.
CS_INLINE Lanes columns() {
  static const float centres[kLanes] = {0.5f, 1.5f, 2.5f, 3.5f, 0.5f, 1.5f, 2.5f, 3.5f,
                                        0.5f, 1.5f, 2.5f, 3.5f, 0.5f, 1.5f, 2.5f, 3.5f};
  return Lanes::load(centres);
}
CS_INLINE Lanes rows() { return repeat_each(0.5f, 1.5f, 2.5f, 3.5f); }

}  // namespace CS_ISA
}  // namespace cs
