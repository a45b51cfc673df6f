from .filtering import denoise_halves as denoise_halves
