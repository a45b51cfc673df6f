from .filtering import denoise_film as denoise_film
