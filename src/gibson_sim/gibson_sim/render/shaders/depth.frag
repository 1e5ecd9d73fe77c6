// Fills the depth and nothing else.
void main() {}
