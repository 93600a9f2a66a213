"""Find and undo the degradations of a drawing's picture: noise, compression, blur, enlargement, odd blending."""
