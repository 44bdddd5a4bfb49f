"""Threefry-2x32 with 20 rounds in Python integers, from the description in Salmon et al., SC11 (2011)."""

WORD = 0xFFFFFFFF
ROTATIONS = (13, 15, 26, 6, 17, 29, 16, 24)


def threefry(key, counter):
    """Two words of output for two words of key and two of counter."""
    schedule = (key[0], key[1], key[0] ^ key[1] ^ 0x1BD11BDA)
    a, b = (counter[0] + schedule[0]) & WORD, (counter[1] + schedule[1]) & WORD
    for number in range(20):
        turn = ROTATIONS[number % 8]
        a = (a + b) & WORD
        b = (((b << turn) | (b >> (32 - turn))) & WORD) ^ a
        if number % 4 == 3:
            injected = number // 4 + 1
            a = (a + schedule[injected % 3]) & WORD
            b = (b + schedule[(injected + 1) % 3] + injected) & WORD
    return a, b
