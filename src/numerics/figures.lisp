;;; Pictures: what drawing them with Maxima's package draw takes beside draw itself.
;;;
;;; Entry points: $anmech_load_draw, $anmech_draw, $anmech_numbered_frame, $anmech_play_frames, $anmech_draw_movie,
;;; $anmech_typed_label, $anmech_name_label, $anmech_short_number, $anmech_make_room, $anmech_file_exists,
;;; $anmech_set_picture_folder, $anmech_next_picture.

(in-package :anmech)
(needs "session/letters" "session/texts")

(maxima::defmfun maxima::$anmech_load_draw ()
  "anmech_load_draw(): draw's functions.  What pictures take of draw is loaded as source: to compile all of draw takes a
quarter of a minute on some Lisps, two sessions that do so at once spoil each other's files, and a motion is drawn as
fast without all but one of them."
  (unless (fboundp 'maxima::$draw2d)
    (let ((sources (mapcar #'maxima::$file_search '("grcommon.lisp" "gnuplot.lisp"))))
      (if (every #'stringp sources)
          (let (#+sbcl (sb-ext:*evaluator-mode* :interpret)
                (*error-output* (make-broadcast-stream))
                (*load-verbose* nil))
            (mapc #'maxima::$load sources)
            ;; SBCL's interpreter would arrange the cases of the one that sets options anew for each of them
            #+sbcl (handler-bind ((warning #'muffle-warning)) (compile 'maxima::update-gr-option)))
          (maxima::$load "draw"))))
  'maxima::$done)

#+ecl
(defun call-with-plain-shell (thunk)
  "Maxima's system() on ECL waits for a command in two threads, which now and then wait for each other for ever."
  (flet ((plain (&rest parts) (ext:system (format nil "~{~a~^ ~}" parts))))
    (let* ((names (remove-if-not #'fboundp (list 'maxima::$system 'maxima::system-impl)))
           (usual (mapcar #'symbol-function names)))
      (unwind-protect
           (progn (dolist (name names) (setf (symbol-function name) #'plain))
                  (funcall thunk))
        (mapc (lambda (name function) (setf (symbol-function name) function)) names usual)))))

(maxima::defmfun maxima::$anmech_draw (draw parts size)
  "anmech_draw(draw2d, [object or option, ...], size): the picture, by draw; SIZE, [width, height], is that of one
inline in wxMaxima, or auto."
  (flet ((picture ()
           (flet ((plain () (maxima::mapply1 draw (rest parts) draw nil)))
             #+ecl (call-with-plain-shell #'plain)
             #-ecl (plain))))
    (if (consp size)
        (let ((maxima::$wxplot_size size))
          (declare (special maxima::$wxplot_size))
          (picture))
        (picture))))

;;; Animations

(maxima::defmfun maxima::$anmech_draw_movie (parts)
  "anmech_draw_movie([object or option, ...]): the pictures, one after the other, by draw.  gnuplot says on the terminal
how many there are."
  (let ((maxima::$gnuplot_command (if (equal maxima::*autoconf-windows* "true")
                                      maxima::$gnuplot_command
                                      (concatenate 'string maxima::$gnuplot_command " 2>/dev/null"))))
    (declare (special maxima::$gnuplot_command))
    (maxima::$anmech_draw 'maxima::$draw parts 'maxima::$auto)))

;;; One inline in wxMaxima, which evaluates what it draws for each number of a slider

(defvar *frames* #() "What is drawn in each picture, as Maxima's lists.")

(maxima::defmfun maxima::$anmech_numbered_frame (number)
  "anmech_numbered_frame(k): the parts of the k-th picture."
  (aref *frames* (1- number)))

(maxima::defmfun maxima::$anmech_play_frames (frames size rate)
  "anmech_play_frames([[object or option, ...], ...], [width, height], pictures in a second)"
  (let ((maxima::$wxplot_size size) (maxima::$wxanimate_framerate rate) (maxima::$wxanimate_autoplay t)
        (*frames* (coerce (rest frames) 'vector)))
    (declare (special maxima::$wxplot_size maxima::$wxanimate_framerate maxima::$wxanimate_autoplay))
    (maxima::meval `((maxima::$with_slider_draw) maxima::$anmech_number ,(length *frames*)
                     ((maxima::$anmech_numbered_frame) maxima::$anmech_number)))))

;;; Texts, as gnuplot takes them

(defun greek-letter (name)
  "The letter that NAME is the name of, in gnuplot's notation, or nil."
  (multiple-value-bind (place capital) (greek-place name)
    (and place (format nil "\\U+~4,'0x" (+ (if capital 913 945) place)))))

(defun as-typed (text)
  "TEXT with what gnuplot would take for its own signs marked."
  (with-output-to-string (out)
    (loop for char across text
          do (when (find char "\\_^{}@&~") (write-char #\\ out))
             (write-char char out))))

(maxima::defmfun maxima::$anmech_typed_label (text)
  "anmech_typed_label(string): shown as it is typed."
  (coerce (as-typed text) 'simple-string))

(maxima::defmfun maxima::$anmech_name_label (name indices order)
  "anmech_name_label(string, string, order): the name of a variable, Greek letters as such, with the indices below it
and as many dots above, one or two; false, if it is too long to bear dots."
  (multiple-value-bind (stem index) (stem-and-index name)
    (let ((letter (greek-letter stem)))
      (if (and (plusp order) (or (> order 2) (and (null letter) (> (length stem) 1))))
          nil
          (coerce (format nil "~a~[~;\\U+0307~;\\U+0308~]~@[_{~a}~]" (or letter (as-typed stem)) order
                          (and (or index (plusp (length indices)))
                               (format nil "~@[~a~]~:[~;,~]~a" (and index (or (greek-letter index) (as-typed index)))
                                       (and index (plusp (length indices))) (as-typed indices))))
                  'simple-string)))))

(maxima::defmfun maxima::$anmech_short_number (number &optional (digits 4))
  "anmech_short_number(number, [digits]): as Maxima writes it, with so many digits."
  (let ((maxima::$fpprintprec digits)) (maxima::mfuncall 'maxima::$string number)))

;;; Files

(defvar *picture-folder* nil "Where pictures go that are given no file, or nil.")
(defvar *pictures* 0 "How many have gone there.")

(maxima::defmfun maxima::$anmech_set_picture_folder (folder)
  "anmech_set_picture_folder(string or false)"
  (setq *pictures* 0
        *picture-folder* (and folder (string-right-trim "/" folder)))
  folder)

(maxima::defmfun maxima::$anmech_next_picture (suffix)
  "anmech_next_picture(suffix): the next file of the folder, or auto if there is none."
  (if *picture-folder*
      (coerce (format nil "~a/picture_~d~a" *picture-folder* (incf *pictures*) suffix) 'simple-string)
      'maxima::$auto))

(maxima::defmfun maxima::$anmech_make_room (file)
  "anmech_make_room(file): its directory exists, it may be written, and it is not there."
  (handler-case (progn (ensure-directories-exist file)
                       (close (open file :direction :output :if-exists :supersede))
                       (delete-file file))
    (error () (complain "cannot write the file ~a" file)))
  'maxima::$done)

(maxima::defmfun maxima::$anmech_file_exists (file)
  "anmech_file_exists(file): and there is something in it."
  (with-open-file (stream file :if-does-not-exist nil :element-type '(unsigned-byte 8))
    (and stream (plusp (file-length stream)))))
